//! Fuzz targets of scenes: the check of the files that they name, and MuJoCo's compiler.

use std::path::PathBuf;
use std::sync::LazyLock;

use envs::mujoco::Model;

use super::{Reading, Target, accepted, measured};

pub const MJCF: Target = Target::new(
    "mjcf",
    |input| read(input, |files| accepted(Model::check_file_references(NAMES[0], files))),
    seeds,
)
.holding(32, 1 << 10)
.tried(20_000);

/// Target of MuJoCo's compiler. Memory is counted for Rust alone: the virtual file system and error
/// messages.
pub const COMPILER: Target =
    Target::new("compiler", |input| read(input, compile), seeds).holding(32, 1 << 21).tried(500);

/// File on the disk that no model may include.
static BAIT: LazyLock<PathBuf> = LazyLock::new(|| {
    let path = std::env::temp_dir().join("covers-fuzz-bait.xml");
    let part = "<mujoco><worldbody><body name='of_the_disk'/></worldbody></mujoco>";
    std::fs::write(&path, part).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    path
});

/// Names and contents of files.
type Files<'a> = [(&'a str, &'a [u8])];

const NAMES: [&str; 4] = ["scene.xml", "task.xml", "a.xml", "b.xml"];

/// Reads files that stand one after the other, separated by zeros.
fn read(input: &[u8], with: fn(&Files) -> bool) -> Option<Reading> {
    LazyLock::force(&BAIT);
    let parts = input.split(|&byte| byte == 0);
    let files: Vec<(&str, &[u8])> = NAMES.into_iter().zip(parts).collect();
    measured(|| with(&files))
}

fn compile(files: &Files) -> bool {
    let model = Model::from_files(NAMES[0], files);
    if let Ok(model) = &model {
        // MuJoCo 3 looks on the disk for what is missing in memory
        let is_sealed = envs::mujoco::is_reference_release();
        assert!(!is_sealed || model.body("of_the_disk").is_err(), "the disk was read");
    }
    accepted(model)
}

fn seeds() -> Vec<Vec<u8>> {
    let bait = BAIT.display();
    let texts = [
        "<mujoco><include file='task.xml'/></mujoco>\0<mujocoinclude><worldbody>\
         <body name='object' mocap='true'><geom size='0.1'/></body></worldbody></mujocoinclude>"
            .to_owned(),
        "<mujoco><compiler meshdir='m'/><asset><mesh name='m' vertex='0 0 0 1 0 0 0 1 0 0 0 1'/>\
         </asset><worldbody><geom type='mesh' mesh='m'/></worldbody></mujoco>"
            .to_owned(),
        "<mujoco><worldbody><body><joint name='j' type='hinge'/><geom type='box' size='1 1 1'/>\
         </body></worldbody><actuator><motor joint='j'/></actuator></mujoco>"
            .to_owned(),
        format!("<mujoco><!-- --><include file='{bait}'/></mujoco>"),
        format!("<mujoco><include file='../../../../../..{bait}'/></mujoco>"),
        format!("<mujoco><asset><hfield name='h' file='{bait}' size='1 1 1 1'/></asset></mujoco>"),
        "<robot name='r'><link name='l'/></robot>".to_owned(),
    ];
    texts.map(String::into_bytes).to_vec()
}
