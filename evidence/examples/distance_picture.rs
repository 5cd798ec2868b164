//! Draws distances of episodes of one group and of others against the thresholds, in drawn worlds.
//!
//! `cargo run --release -p covers-evidence --example distance_picture -- docs/assignment.svg`

#[path = "../tests/common/mod.rs"]
mod common;

use std::error::Error;
use std::fmt::Write as _;

use common::{accounts, stream};
use evidence::{Account, Opinion, Recogniser, RecogniserSettings, Situation};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use worlds::Kind;

type Answer<T> = Result<T, Box<dyn Error>>;

/// Groups of each world that are known, and worlds of each kind.
const GROUPS: usize = 3;
const SEEDS: std::ops::Range<u64> = 1000..1010;
/// A figure of what a policy's own 20 episodes show.
struct Panel {
    name: &'static str,
    of: fn(&Opinion) -> f64,
    threshold: fn(&RecogniserSettings) -> f64,
    /// Where the axis begins and ends; what lies outside is drawn at its end.
    axis: [f64; 2],
}

const PANELS: [Panel; 4] = [
    panel(
        "picture: distance over chance",
        Opinion::look_ratio,
        |s| s.min_ratio,
        [0.5, 4.0],
    ),
    panel(
        "motion: change",
        Opinion::changed,
        |s| s.min_motion,
        [0.0, 2.0],
    ),
    panel(
        "the way that pays: change",
        Opinion::turned,
        |s| s.min_motion,
        [0.0, 1.2],
    ),
    panel(
        "earnings: share lost",
        Opinion::lost,
        |s| s.min_loss,
        [-0.5, 1.2],
    ),
];

const fn panel(
    name: &'static str,
    of: fn(&Opinion) -> f64,
    threshold: fn(&RecogniserSettings) -> f64,
    axis: [f64; 2],
) -> Panel {
    Panel {
        name,
        of,
        threshold,
        axis,
    }
}

/// Opinions on episodes of a policy's own group, and on those of other groups.
type Pairs = [Vec<Opinion>; 2];

fn main() -> Answer<()> {
    let path = std::env::args()
        .nth(1)
        .unwrap_or("assignment.svg".to_owned());
    let mut rows = Vec::new();
    for kind in Kind::ALL
        .into_iter()
        .filter(|&kind| kind != Kind::Identical)
    {
        rows.push((kind.name(), pairs(kind)?));
    }
    std::fs::write(&path, drawing(&rows)?)?;
    println!("wrote {path}");
    Ok(())
}

/// Lets each policy act in its own group and in the others of its world.
fn pairs(kind: Kind) -> Answer<Pairs> {
    let mut found = Pairs::default();
    for seed in SEEDS {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut recogniser = Recogniser::new(RecogniserSettings::default())?;
        let groups = GROUPS.min(worlds::World::draw(kind, seed).groups.len());
        for group in 0..groups {
            let mut learnt = accounts(stream(kind, seed, &[(group, 12)], 5), 12, None);
            learnt[..20]
                .iter_mut()
                .for_each(|account| account.earned = Some(0.0));
            for rollout in learnt.chunks(20) {
                recogniser.learn(group, rollout, &mut rng)?;
            }
        }
        for (policy, group) in (0..groups).flat_map(|p| (0..groups).map(move |g| (p, g))) {
            let seen = accounts(stream(kind, seed, &[(group, 20)], 5), 20, Some(policy));
            let last: &[Account] = &seen[80..];
            let situation = Situation {
                collector: policy,
                refused: &[],
            };
            let finding = recogniser.review(last, situation, &mut rng)?;
            let other = usize::from(policy != group);
            found[other].extend(finding.opinions.into_iter().nth(policy));
        }
    }
    Ok(found)
}

/// Where panels begin, their width, and the height of a row.
const LEFT: f64 = 90.0;
const WIDTH: f64 = 200.0;
const GAP: f64 = 24.0;
const ROW: f64 = 44.0;
const TOP: f64 = 48.0;
/// Colours of one group and of two (Okabe and Ito, "Color Universal Design", 2008).
const COLOURS: [&str; 2] = ["#0072B2", "#D55E00"];

fn drawing(rows: &[(&str, Pairs)]) -> Answer<String> {
    let settings = RecogniserSettings::default();
    let width = LEFT + PANELS.len() as f64 * (WIDTH + GAP);
    let bottom = TOP + rows.len() as f64 * ROW;
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" \
         font-family=\"sans-serif\" font-size=\"11\">\n\
         <rect width=\"{width}\" height=\"{height}\" fill=\"white\"/>\n\
         <text x=\"{LEFT}\" y=\"16\" fill=\"{}\">own group</text>\n\
         <text x=\"{}\" y=\"16\" fill=\"{}\">another group</text>\n",
        COLOURS[0],
        LEFT + 80.0,
        COLOURS[1],
        height = bottom + 30.0,
    );
    for (row, (name, _)) in rows.iter().enumerate() {
        let y = TOP + (row as f64 + 0.6) * ROW;
        writeln!(svg, "<text x=\"8\" y=\"{y:.1}\">{name}</text>")?;
    }
    for (index, panel) in PANELS.iter().enumerate() {
        let left = LEFT + index as f64 * (WIDTH + GAP);
        let [from, to] = panel.axis;
        let x = |value: f64| left + WIDTH * (value.clamp(from, to) - from) / (to - from);
        let (height, name) = (bottom - TOP, panel.name);
        writeln!(
            svg,
            "<rect x=\"{left}\" y=\"{TOP}\" width=\"{WIDTH}\" height=\"{height}\" fill=\"none\" \
             stroke=\"#999\"/>\n<text x=\"{left}\" y=\"{}\">{name}</text>",
            TOP - 8.0
        )?;
        let limit = (panel.threshold)(&settings);
        for (value, dash) in [(from, ""), (to, ""), (limit, "4 3")] {
            let at = x(value);
            writeln!(
                svg,
                "<line x1=\"{at:.1}\" x2=\"{at:.1}\" y1=\"{TOP}\" y2=\"{bottom}\" stroke=\"black\" \
                 stroke-width=\"0.7\" stroke-dasharray=\"{dash}\"/>\n\
                 <text x=\"{at:.1}\" y=\"{}\" text-anchor=\"middle\">{value}</text>",
                bottom + 14.0
            )?;
        }
        for (row, (_, pairs)) in rows.iter().enumerate() {
            for (side, opinions) in pairs.iter().enumerate() {
                let y = TOP + (row as f64 + 0.32 + 0.36 * side as f64) * ROW;
                for opinion in opinions {
                    let at = x((panel.of)(opinion));
                    let colour = COLOURS[side];
                    writeln!(
                        svg,
                        "<circle cx=\"{at:.1}\" cy=\"{y:.1}\" r=\"3\" fill=\"{colour}\" \
                         fill-opacity=\"0.5\"/>"
                    )?;
                }
            }
        }
    }
    Ok(svg + "</svg>\n")
}
