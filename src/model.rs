//! `covers model`: comparison of the left and the right side of a robot's model.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use clap::{Args, Subcommand};
use experiments::RunError;
use experiments::cli::print_escaped;
use learner::disk::{LocalDisk, write_atomically};
use model_check::{
    ModelSymmetrySettings, PlaneAndPairCorrections, check_model_symmetry, read_model,
};
use serde::Serialize;

use crate::CoversError;

/// Subcommands of `covers model`.
#[derive(Clone, Debug, Subcommand)]
pub enum ModelCommand {
    /// Lists the differences between left and right, and fails if there are any.
    #[command(after_help = "Examples:\n  covers model check robot.xml\n  \
        covers model check robot.xml --write-pairs pairs.json\n  \
        covers model check robot.xml --pairs pairs.json --maps maps.json\n  \
        covers model check robot.xml --html robot.html")]
    Check(ModelCheckOptions),
}

/// Options of `covers model check`.
#[derive(Clone, Debug, Args)]
pub struct ModelCheckOptions {
    /// MJCF file that the linked MuJoCo loads, a URDF of a robot, or a JSON file of settings that
    /// names one.
    #[arg(value_name = "MODEL")]
    pub model: PathBuf,
    /// Smallest difference that is listed: a share of the value, or an angle in radians; lengths
    /// count from a tenth of it, in metres.
    #[arg(long, default_value_t = 1e-3)]
    pub tolerance: f64,
    /// Corrections of the mirror plane and the pairs, a JSON file as `--write-pairs` writes it.
    #[arg(long, value_name = "FILE")]
    pub pairs: Option<PathBuf>,
    /// Write the plane and the pairs that were used.
    #[arg(long, value_name = "FILE")]
    pub write_pairs: Option<PathBuf>,
    /// Write the permutations and signs of states, sensor data and actions.
    #[arg(long, value_name = "FILE")]
    pub maps: Option<PathBuf>,
    /// Write the report as an HTML page with pictures of the model.
    #[arg(long, value_name = "FILE")]
    pub html: Option<PathBuf>,
    /// Print one JSON object instead of a text.
    #[arg(long)]
    pub json: bool,
}

impl ModelCommand {
    /// Runs the command, prints to `out`, and returns `false` if it found differences.
    ///
    /// # Errors
    /// A model or file that cannot be read, and files that cannot be written to.
    pub fn run(&self, out: &mut impl Write) -> Result<bool, CoversError> {
        let Self::Check(options) = self;
        let corrections = match &options.pairs {
            Some(path) => PlaneAndPairCorrections::read(path)?,
            None => PlaneAndPairCorrections::default(),
        };
        let settings = ModelSymmetrySettings {
            tolerance: options.tolerance,
            corrections,
            ..ModelSymmetrySettings::default()
        };
        let model = Arc::new(read_model(&options.model)?);
        let found = check_model_symmetry(&model, &settings)?;
        write_json(options.write_pairs.as_deref(), &found.corrections)?;
        write_json(options.maps.as_deref(), &found.maps)?;
        if let Some(path) = &options.html {
            let title = options.model.file_name().unwrap_or_default().to_string_lossy();
            let page = found.html(&title, &model)?;
            write_atomically(&LocalDisk, path, page.as_bytes()).map_err(RunError::from)?;
        }
        let printed =
            if options.json { serde_json::json!(found).to_string() } else { found.text() };
        print_escaped(out, printed.trim_end())?;
        Ok(found.differences.is_empty())
    }
}

fn write_json(path: Option<&Path>, value: &impl Serialize) -> Result<(), RunError> {
    path.map_or(Ok(()), |path| {
        let text = format!("{:#}\n", serde_json::json!(value));
        write_atomically(&LocalDisk, path, text.as_bytes()).map_err(RunError::from)
    })
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use crate::program::CoversCli;

    #[test]
    fn a_check_lists_differences_and_writes_pairs_that_it_reads() {
        let quadruped = concat!(env!("CARGO_MANIFEST_DIR"), "/assets/models/quadruped.xml");
        let folder = std::env::temp_dir().join(format!("covers-model-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let path = |name: &str| folder.join(name).to_str().unwrap().to_owned();
        let run = |words: &[&str]| {
            let mut out = Vec::new();
            let program =
                CoversCli::try_parse_from([&["covers", "model", "check"], words].concat()).unwrap();
            let code = program.run(&mut out).map_err(|error| error.to_string());
            (code, String::from_utf8(out).unwrap())
        };
        let [pairs, maps, heavy, page] =
            ["pairs.json", "maps.json", "heavy.xml", "page.html"].map(path);
        let (code, text) = run(&[quadruped, "--write-pairs", &pairs, "--maps", &maps]);
        assert!(code == Ok(0) && text.contains("no differences"), "{text}");
        let written = std::fs::read_to_string(&maps).unwrap();
        let written: serde_json::Value = serde_json::from_str(&written).unwrap();
        assert_eq!(written["qpos"]["sources"].as_array().unwrap().len(), 19);
        let model = std::fs::read_to_string(quadruped).unwrap();
        std::fs::write(&heavy, model.replacen("mass=\"0.9\"", "mass=\"0.95\"", 1)).unwrap();
        let (differs, json) = run(&[&heavy, "--pairs", &pairs, "--html", &page, "--json"]);
        let json: serde_json::Value = serde_json::from_str(&json).unwrap();
        assert_eq!(differs, Ok(1));
        assert_eq!(json["differences"].as_array().unwrap().len(), 1, "{json}");
        assert_eq!(json["differences"][0]["property"], "mass");
        let page = std::fs::read_to_string(&page).unwrap();
        assert!(page.contains("<h1>heavy.xml: left and right</h1>"), "{page}");
        std::fs::write(&pairs, "{\"pairs\": {\"joint\": [[\"FL_hip\", \"FX_hip\"]]}}").unwrap();
        let (unknown, _) = run(&[quadruped, "--pairs", &pairs]);
        let message = unknown.unwrap_err();
        assert!(message.contains("no joint `FX_hip`") && message.contains("FR_hip"), "{message}");
        std::fs::remove_dir_all(folder).unwrap();
    }
}
