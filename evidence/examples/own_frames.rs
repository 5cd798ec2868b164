//! Will recognition work in an environment of your own? Measures it on its first frames.
//!
//! `cargo run --release -p covers-evidence --example own_frames -- FOLDER`
//!
//! FOLDER holds one folder for each group of tasks, and those hold the first image of each of its
//! episodes as PNG files of one size and colour type, 8 bits a channel; 40 of each group are
//! plenty, 20 will do. Half of each group is remembered, and the other half is asked about. Without
//! FOLDER the frames of a drawn world are measured.

use std::error::Error;
use std::fs::{self, File};
use std::io::BufReader;
use std::path::{Path, PathBuf};

use cluster::PolicyVerdict;
use evidence::{
    EpisodeSummary, RandomFilters, Recogniser, RecogniserSettings, RolloutDecisionContext,
};
use rand::seq::SliceRandom;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rl::{Observations, VectorEnv};
use worlds::{GroupVisit, TaskStream, World, WorldKind};

type Answer<T> = Result<T, Box<dyn Error + Send + Sync>>;

/// Random halves of each group: one is remembered, the other is asked about.
const REPETITIONS: usize = 10;

struct Group {
    name: String,
    summaries: Vec<EpisodeSummary>,
}

fn main() -> Answer<()> {
    let groups = match std::env::args().nth(1) {
        Some(folder) => read(Path::new(&folder))?,
        None => drawn()?,
    };
    let mut rng = ChaCha8Rng::seed_from_u64(0);
    pairs(&groups, &mut rng)?;
    recognition(&groups, &mut rng)
}

/// A line for each two groups, and for each group and itself.
fn pairs<R: Rng>(groups: &[Group], rng: &mut R) -> Answer<()> {
    println!("| remembered | asked about | distance over chance | score | rejected |");
    println!("|---|---|---|---|---|");
    for own in groups {
        for other in groups {
            let (mut ratio, mut score, mut rejected) = (0.0, 0.0, 0);
            for _ in 0..REPETITIONS {
                let [remembered, asked] = halves(own, other, rng);
                let mut recogniser = Recogniser::new(RecogniserSettings::default())?;
                recogniser.record_training(0, &remembered, rng)?;
                let context = RolloutDecisionContext {
                    allow_undecided: false,
                    ..RolloutDecisionContext::for_collector(0)
                };
                let decision = recogniser.assign_rollout(&asked, context, rng)?;
                let result = &decision.tests[0];
                let test = result.test.as_ref().ok_or("fewer than 4 frames of a group")?;
                let image = test.sources[0];
                ratio += image.map_or(1.0, |s| s.distance_ratio()) / REPETITIONS as f64;
                score += image.map_or(0.0, |s| s.score) / REPETITIONS as f64;
                rejected += usize::from(result.verdict == PolicyVerdict::Rejected);
            }
            let (own, other) = (&own.name, &other.name);
            println!("| {own} | {other} | {ratio:.2} | {score:.1} | {rejected} of {REPETITIONS} |");
        }
    }
    Ok(())
}

/// Frames of one group to remember and of another, or of the same, to ask about.
fn halves<R: Rng>(own: &Group, other: &Group, rng: &mut R) -> [Vec<EpisodeSummary>; 2] {
    let mut shuffled = own.summaries.clone();
    shuffled.shuffle(rng);
    let asked = shuffled.split_off(shuffled.len() / 2);
    if std::ptr::eq(own, other) {
        return [shuffled, asked];
    }
    let mut others = other.summaries.clone();
    others.shuffle(rng);
    others.truncate(others.len() / 2);
    [shuffled, others]
}

/// How often 1, 4 and 20 frames, or all that half of the group has, name their group, with all
/// groups known and with their own unknown.
fn recognition<R: Rng>(groups: &[Group], rng: &mut R) -> Answer<()> {
    println!("\n| frames | right | its own group unknown: \"none of these\" |\n|---|---|---|");
    for frames in [1, 4, 20] {
        let (mut right, mut none, mut asked) = (0, 0, 0);
        let (mut fewest, mut most) = (frames, 0);
        for _ in 0..REPETITIONS {
            for (index, group) in groups.iter().enumerate() {
                let mut known = Recogniser::new(RecogniserSettings::default())?;
                let mut question = Vec::new();
                for (policy, other) in groups.iter().enumerate() {
                    let [remembered, rest] = halves(other, other, rng);
                    known.record_training(policy, &remembered, rng)?;
                    if policy == index {
                        question = rest;
                    }
                }
                question.truncate(frames);
                (fewest, most) = (fewest.min(question.len()), most.max(question.len()));
                right += usize::from(
                    known.task_group_probabilities(&question, rng)?.most_probable_policy()
                        == Some(index),
                );
                let mut others = Recogniser::new(RecogniserSettings::default())?;
                let rest = groups.iter().filter(|other| other.name != group.name);
                for (policy, other) in rest.enumerate() {
                    others.record_training(policy, &halves(other, other, rng)[0], rng)?;
                }
                none += usize::from(
                    others
                        .task_group_probabilities(&question, rng)?
                        .most_probable_policy()
                        .is_none(),
                );
                asked += 1;
            }
        }
        let used = if fewest == most { format!("{most}") } else { format!("{fewest} to {most}") };
        println!("| {used} | {right} of {asked} | {none} of {asked} |");
    }
    Ok(())
}

fn read(folder: &Path) -> Answer<Vec<Group>> {
    let mut groups = Vec::new();
    let mut first = None;
    for path in sorted(folder)?.into_iter().filter(|path| path.is_dir()) {
        let name = path.file_name().unwrap_or_default().to_string_lossy().into();
        let mut summaries = Vec::new();
        for file in sorted(&path)? {
            let (size, pixels) = image(&file)?;
            let expected = *first.get_or_insert(size);
            if size != expected {
                let file_name = file.display();
                let problem =
                    format!("{file_name} is {size:?}, expected {expected:?} as the first");
                return Err((problem + " image: height, width and channels").into());
            }
            let filters = RandomFilters::new(size, RecogniserSettings::default().filters)?;
            summaries.push(summary(summaries.len(), filters.features(&pixels)?));
        }
        groups.push(Group { name, summaries });
    }
    match groups.len() {
        0 | 1 => Err(format!("{} groups, expected at least 2 folders", groups.len()).into()),
        _ => Ok(groups),
    }
}

fn sorted(folder: &Path) -> Answer<Vec<PathBuf>> {
    let entries = fs::read_dir(folder)?.map(|entry| Ok(entry?.path()));
    let mut paths = entries.collect::<Answer<Vec<_>>>()?;
    paths.sort();
    Ok(paths)
}

/// Height, width and channels of a image, and its pixels.
fn image(path: &Path) -> Answer<([usize; 3], Vec<u8>)> {
    let mut decoder = png::Decoder::new(BufReader::new(File::open(path)?));
    decoder.set_transformations(png::Transformations::normalize_to_color8());
    let mut reader = decoder.read_info()?;
    let mut pixels = vec![0; reader.output_buffer_size().ok_or("the image is too large")?];
    let info = reader.next_frame(&mut pixels)?;
    pixels.truncate(info.buffer_size());
    let channels = info.color_type.samples();
    Ok(([info.height as usize, info.width as usize, channels], pixels))
}

fn summary(began: usize, image_features: Vec<f32>) -> EpisodeSummary {
    EpisodeSummary {
        began,
        image_features,
        first_vector: vec![0.0],
        motion: None,
        reward_gradient: None,
        episode_return: None,
    }
}

/// 40 first frames of each group of a drawn world.
fn drawn() -> Answer<Vec<Group>> {
    let world = World::random(WorldKind::Appearance, 1000);
    let mut groups = Vec::new();
    for group in 0..world.groups.len() {
        let visits = vec![GroupVisit::new(group, 1)];
        let mut stream = TaskStream::new(world.clone(), visits, 40)?;
        let spec = stream.spec().clone();
        let mut seen = Observations::new(&spec);
        stream.reset(&mut seen)?;
        let filters = RandomFilters::new(spec.image_shape, RecogniserSettings::default().filters)?;
        let images = seen.images.chunks(spec.image_len());
        let features = images.map(|image| filters.features(image));
        let features = features.collect::<Result<Vec<_>, _>>()?;
        let summaries = features.into_iter().enumerate();
        groups.push(Group {
            name: format!("{:?} {:?}", world.groups[group].appearance.shape, group),
            summaries: summaries.map(|(began, described)| summary(began, described)).collect(),
        });
    }
    Ok(groups)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    /// A black image of 8 x 8, or of another width or colour type, in a folder of its own.
    fn write(folder: &Path, group: &str, width: u32, colour: png::ColorType) {
        let folder = folder.join(group);
        fs::create_dir_all(&folder).unwrap();
        let file = File::create(folder.join("0.png")).unwrap();
        let mut encoder = png::Encoder::new(file, width, 8);
        encoder.set_color(colour);
        let pixels = vec![0; width as usize * 8 * colour.samples()];
        let mut writer = encoder.write_header().unwrap();
        writer.write_image_data(&pixels).unwrap();
    }

    #[test]
    fn groups_need_pictures_of_one_kind() {
        let folder = std::env::temp_dir().join(format!("own-frames-{}", std::process::id()));
        let (rgb, grey) = (png::ColorType::Rgb, png::ColorType::Grayscale);
        write(&folder, "a", 8, rgb);
        let error = |answer: Answer<Vec<Group>>| answer.err().unwrap().to_string();
        assert!(error(read(&folder)).contains("1 groups, expected at least 2"));
        write(&folder, "b", 8, rgb);
        assert_eq!(read(&folder).unwrap().len(), 2);
        for (width, colour, size) in [(9, rgb, "[8, 9, 3]"), (8, grey, "[8, 8, 1]")] {
            write(&folder, "b", width, colour);
            let message = error(read(&folder));
            assert!(message.contains(size), "{message}");
        }
        fs::remove_dir_all(&folder).unwrap();
    }
}
