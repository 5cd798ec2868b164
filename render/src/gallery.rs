//! Films of all groups of a run, one for each.

use envs::TaskRegistry;
use symmetry::D2;

use experiments::{RunError, RunFolder, thread_pool};

use super::gif::encode;
use super::mosaic::mosaic;
use super::show::{Shot, Show};
use super::studio::View;

/// Decisions that a film shows, three seconds of the table.
const DECISIONS: usize = 24;

/// Plays one episode of each variant with the policies of the newest intact checkpoint; returns
/// each group's name and a GIF file of its four variants as the policies see them.
///
/// # Errors
/// A folder without policies; what the environments or the learner say.
pub fn gallery(folder: &RunFolder, threads: usize) -> Result<Vec<(String, Vec<u8>)>, RunError> {
    let groups = folder.experiment()?.schedule.resolve(&TaskRegistry::standard())?;
    let mut show = Show::load(folder, threads)?;
    let pool = thread_pool(threads)?;
    let names = D2::ALL.map(|element| element.to_string());
    let films = groups.into_iter().map(|group| {
        let shot = Shot {
            groups: &[group],
            views: &[View::Seen],
            twins: false,
            decisions: Some(DECISIONS),
            seed: 0,
        };
        let played = pool.install(|| show.play(&shot))?;
        let columns = names.each_ref().map(String::as_str);
        let film = mosaic(&columns, &show.rows(&shot, &played));
        let gif = encode(&film).map_err(|error| RunError::write(folder.path(), error))?;
        Ok((group.name().to_owned(), gif))
    });
    films.collect()
}
