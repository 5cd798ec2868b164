//! What `covers rerun` refuses, and, with the feature `rerun`, what it records.

use std::path::Path;

use clap::Parser;
use covers::CoversError;
use covers::rerun::RerunOptions;

use crate::common::scratch::Scratch;

#[derive(Parser)]
struct Options {
    #[command(flatten)]
    rerun: RerunOptions,
}

fn rerun(run: &str, out: &Path, more: &[&str]) -> Result<String, CoversError> {
    let arguments = [&["rerun", run, "--out", out.to_str().unwrap()], more].concat();
    let options = Options::try_parse_from(arguments).unwrap().rerun;
    let mut said = Vec::new();
    options.run(&mut said)?;
    Ok(String::from_utf8(said).unwrap())
}

#[cfg(not(feature = "rerun"))]
#[test]
fn a_program_without_recordings_says_how_to_build_one_that_makes_them() {
    let scratch = Scratch::new("no-rerun");
    let error = rerun("assets/pretrained", &scratch.0.join("film.rrd"), &[]).unwrap_err();
    assert!(matches!(error, CoversError::NoRerun), "{error}");
    assert!(error.to_string().contains("`--features rerun`"), "{error}");
}

#[cfg(feature = "rerun")]
mod recordings {
    use std::fs;

    use covers::presets::Method;
    use covers::{Run, RunFolder};

    use crate::common::packed::small;

    use super::*;

    /// Whether a recording has an entity of this name: entities stand in it by name.
    fn holds(recording: &[u8], entity: &str) -> bool {
        let mut places = recording.windows(entity.len());
        places.any(|place| place == entity.as_bytes())
    }

    #[test]
    fn a_recording_names_what_it_holds() {
        let scratch = Scratch::new("rerun");
        let folder = RunFolder::create(&scratch.0, "run").unwrap();
        let mut run = Run::start(small(Method::Covers), folder).unwrap();
        while run.advance().unwrap().is_some() {}
        let folder = run.folder().path().to_str().unwrap().to_owned();
        drop(run);
        let film = scratch.0.join("new/film.rrd");
        let said = rerun(&folder, &film, &["--group", "button-press"]).unwrap();
        assert!(said.contains("button-press half turn: policy 0"), "{said}");
        let bytes = fs::read(&film).unwrap();
        assert!(bytes.starts_with(b"RRF"));
        let half_turn = "/button-press/half-turn";
        for entity in [
            "/stream/group",
            "/stream/policy",
            "/stream/reward",
            half_turn,
        ] {
            assert!(holds(&bytes, entity), "{entity}");
        }
        assert!(!holds(&bytes, "/goal-reach/half-turn"));
        let again = rerun(&folder, &film, &[]).unwrap_err();
        assert!(matches!(again, CoversError::FileExists { .. }), "{again}");
    }

    #[test]
    fn other_endings_and_groups_are_refused_before_anything_is_written() {
        let scratch = Scratch::new("rerun-refused");
        let policies = "assets/pretrained";
        let gif = scratch.0.join("film.gif");
        let error = rerun(policies, &gif, &[]).unwrap_err().to_string();
        assert!(error.contains("the ending .rrd"), "{error}");
        let film = scratch.0.join("film.rrd");
        let error = rerun(policies, &film, &["--group", "no-group"]).unwrap_err();
        assert!(error.to_string().contains("no-group"), "{error}");
        let error = rerun("no-run", &film, &[]).unwrap_err();
        assert!(error.to_string().contains("no-run"), "{error}");
        assert_eq!(fs::read_dir(&scratch.0).unwrap().count(), 0);
        assert!(!RunFolder::open(Path::new("no-run")).holds_run());
    }
}
