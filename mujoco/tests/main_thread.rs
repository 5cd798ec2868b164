//! Program with one thread, without the test harness: drawing prints nothing, and Mesa draws on the
//! calling thread.

#![allow(clippy::unwrap_used, reason = "test code")]

use std::env;
use std::process::Command;
use std::sync::Arc;

use mujoco::{Data, Model, RenderOptions, Renderer};

/// Environment variable that is set in the child.
const CHILD: &str = "COVERS_TEST_CHILD";
const THREADS: &str = "LP_NUM_THREADS";

fn main() {
    if env::var_os(CHILD).is_some() {
        return draw();
    }
    for (given, expected) in [(None, "0"), (Some("3"), "3")] {
        let mut child = Command::new(env::current_exe().unwrap());
        child.env(CHILD, "1").env_remove(THREADS).envs(given.map(|value| (THREADS, value)));
        let output = child.output().unwrap();
        assert!(output.status.success(), "{output:?}");
        assert_eq!(String::from_utf8_lossy(&output.stdout), expected);
        assert_eq!(String::from_utf8_lossy(&output.stderr), "", "OpenGL must not chatter");
    }
}

fn draw() {
    let xml = r#"<mujoco><worldbody><camera name="top" pos="0 0 2"/></worldbody></mujoco>"#;
    let model = Arc::new(Model::from_xml(xml).unwrap());
    let camera = model.camera("top").unwrap();
    let mut data = Data::new(model.clone());
    data.forward().unwrap();
    let mut renderer = Renderer::new(model, 12, 8, RenderOptions::default()).unwrap();
    let mut image = vec![0; renderer.image_len()];
    renderer.render(&mut data, camera, &mut image).unwrap();
    print!("{}", env::var(THREADS).unwrap_or_default());
}
