//! A compiled scene: arena, embodiment and task in one model, with the ids that the environment reads.

use std::sync::Arc;

use glam::DVec3;
use mujoco::{BodyId, CameraId, Data, MocapId, Model, SiteId, State};

use crate::EnvError;
use crate::camera::Camera;
use crate::task::{Parts, TaskGroup};

/// Where the hand's target stands at the start of every episode (metres): over the centre, clear of an open drawer.
pub const HAND_START: DVec3 = DVec3::new(0.0, 0.0, 0.22);

/// File name of the scene that includes the parts.
const MAIN: &str = "scene.xml";
const ARENA: (&str, &str) = ("arena.xml", include_str!("../../assets/mjcf/arena.xml"));
const SAWYER: (&str, &str) = ("sawyer.xml", include_str!("../../assets/mjcf/sawyer.xml"));

/// Joint positions (radians) near the arm's rest with the hand at [`HAND_START`].
const SAWYER_POSTURE: [(&str, f64); 7] = [
    ("j0", 1.932580),
    ("j1", -0.499083),
    ("j2", -1.058834),
    ("j3", 1.651000),
    ("j4", 1.047360),
    ("j5", 1.084860),
    ("j6", 2.292554),
];

/// Physics steps until the arm is at rest at its start: 10 s.
const SETTLE_STEPS: usize = 4000;

/// What carries the gripper.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Embodiment {
    /// A seven-joint Sawyer arm.
    #[default]
    Sawyer,
    /// The gripper alone on three slides; not built yet.
    Hand,
}

impl std::str::FromStr for Embodiment {
    type Err = EnvError;

    fn from_str(name: &str) -> Result<Self, EnvError> {
        match name {
            "sawyer" => Ok(Self::Sawyer),
            "hand" => Ok(Self::Hand),
            _ => Err(EnvError::UnknownEmbodiment {
                name: name.to_owned(),
            }),
        }
    }
}

impl Embodiment {
    pub(crate) fn source(self) -> Result<(&'static str, &'static str), EnvError> {
        match self {
            Self::Sawyer => Ok(SAWYER),
            Self::Hand => Err(EnvError::EmbodimentNotBuilt { name: "hand" }),
        }
    }
}

/// A model of one task group with one embodiment, at rest; shared by any number of environments.
#[derive(Debug)]
pub struct Scene {
    /// The task group.
    pub group: TaskGroup,
    /// The compiled model.
    pub model: Arc<Model>,
    /// The camera over the centre.
    pub camera: Camera,
    pub(crate) camera_id: CameraId,
    pub(crate) hand: BodyId,
    pub(crate) claws: [BodyId; 2],
    pub(crate) tips: [SiteId; 2],
    pub(crate) hand_target: MocapId,
    pub(crate) object: Option<MocapId>,
    pub(crate) goal: Option<MocapId>,
    pub(crate) object_body: Option<BodyId>,
    /// Addresses in `qpos` and positions of the joints that an episode starts away from zero.
    pub(crate) start_joints: Vec<(usize, f64)>,
    /// The state at rest with open fingers, from which every episode starts.
    pub(crate) settled: State,
}

impl Scene {
    /// Compiles the scene of `group` and lets it come to rest.
    ///
    /// # Errors
    /// [`EnvError::EmbodimentNotBuilt`], or what MuJoCo says of the model.
    pub fn new(group: TaskGroup, embodiment: Embodiment, camera: Camera) -> Result<Self, EnvError> {
        camera.check()?;
        let parts = group.task().parts();
        let model = Arc::new(compile(parts, embodiment, &camera)?);
        let mocap = |name| model.mocap(name);
        let start_joints = parts
            .start_joints
            .iter()
            .map(|&(name, position)| Ok((model.joint_qpos_address(model.joint(name)?), position)));
        Ok(Self {
            group,
            camera,
            camera_id: model.camera("top")?,
            hand: model.body("hand")?,
            claws: [model.body("right_claw")?, model.body("left_claw")?],
            tips: [model.site("right_tip")?, model.site("left_tip")?],
            hand_target: mocap("hand_target")?,
            object: parts.scene.map(|_| mocap("object")).transpose()?,
            goal: mocap("goal").ok(),
            object_body: parts.object_body.map(|name| model.body(name)).transpose()?,
            start_joints: start_joints.collect::<Result<_, EnvError>>()?,
            settled: settle(&model)?,
            model,
        })
    }
}

fn compile(task: &Parts, embodiment: Embodiment, camera: &Camera) -> Result<Model, EnvError> {
    let mut parts = vec![ARENA, embodiment.source()?];
    parts.extend(task.scene);
    let includes: String = parts
        .iter()
        .map(|(name, _)| format!("<include file=\"{name}\"/>"))
        .collect();
    let main = format!("<mujoco>{includes}{}</mujoco>", camera.to_mjcf("top"));
    parts.push((MAIN, &main));
    let files: Vec<(&str, &[u8])> = parts
        .iter()
        .map(|&(name, text)| (name, text.as_bytes()))
        .collect();
    Ok(Model::from_files(MAIN, &files)?)
}

fn settle(model: &Arc<Model>) -> Result<State, EnvError> {
    let mut data = Data::new(Arc::clone(model));
    for (name, angle) in SAWYER_POSTURE {
        let address = model.joint_qpos_address(model.joint(name)?);
        data.qpos_mut()[address] = angle;
    }
    data.set_mocap_position(model.mocap("hand_target")?, HAND_START.to_array())?;
    data.set_ctrl(&OPEN_FINGERS)?;
    data.step(SETTLE_STEPS)?;
    Ok(data.save())
}

/// Controls of the two finger actuators that hold the gripper open.
const OPEN_FINGERS: [f64; 2] = [-1.0, 1.0];
