//! A compiled scene: arena, embodiment and task in one model, with the ids that the environment reads.

use std::sync::Arc;

use glam::DVec3;
use mujoco::{BodyId, CameraId, Data, MocapId, Model, SiteId, State};
use rand_chacha::ChaCha8Rng;

use crate::EnvError;
use crate::camera::Camera;
use crate::embodiment::Embodiment;
use crate::layout::{Layout, Settling};
use crate::mjcf::{Mjcf, part};
use crate::task::{Placement, TaskGroup};

/// Where the hand's target stands at the start of every episode of the symmetric layout (metres): over the centre, clear of an open drawer.
pub const HAND_START: DVec3 = DVec3::new(0.0, 0.0, 0.22);

/// File name of the scene that includes the parts.
const MAIN: &str = "scene.xml";
const ARENA: Mjcf = part!("arena.xml");
const GRIPPER: Mjcf = part!("gripper.xml");

/// A model of one task group with one embodiment, at rest; shared by any number of environments.
#[derive(Debug)]
pub struct Scene {
    /// Whose figures it follows.
    pub layout: Layout,
    /// The task group.
    pub group: TaskGroup,
    /// What carries the gripper.
    pub embodiment: Embodiment,
    /// The compiled model.
    pub model: Arc<Model>,
    /// The camera over the centre.
    pub camera: Camera,
    pub(crate) camera_id: CameraId,
    /// Where the hand's target stands when an episode starts (metres).
    pub(crate) hand_start: DVec3,
    pub(crate) hand: BodyId,
    pub(crate) claws: [BodyId; 2],
    pub(crate) tips: [SiteId; 2],
    pub(crate) hand_target: MocapId,
    pub(crate) object: Option<MocapId>,
    pub(crate) goal: Option<MocapId>,
    pub(crate) object_body: Option<BodyId>,
    /// Addresses in `qpos` and positions of the joints that an episode starts away from zero.
    pub(crate) start_joints: Vec<(usize, f64)>,
    /// Address in `qpos` of the loose cylinder's position, where there is one.
    pub(crate) decoy: Option<usize>,
    /// The state from which every episode starts.
    pub(crate) settled: State,
}

impl Scene {
    /// Compiles the scene of `group` in the symmetric layout and lets it come to rest.
    ///
    /// # Errors
    /// [`EnvError::Setting`] for an impossible camera, or what MuJoCo says of the model.
    pub fn new(group: TaskGroup, embodiment: Embodiment, camera: Camera) -> Result<Self, EnvError> {
        Self::in_layout(Layout::Symmetric, group, embodiment, camera)
    }

    /// Compiles the scene of `group` in `layout` and brings it to where its episodes start.
    ///
    /// # Errors
    /// As [`Scene::new`].
    pub fn in_layout(
        layout: Layout,
        group: TaskGroup,
        embodiment: Embodiment,
        camera: Camera,
    ) -> Result<Self, EnvError> {
        camera.check()?;
        let parts = group.task().parts();
        let model = Arc::new(compile(layout, group, embodiment, &camera)?);
        let settling = layout.settling(group, embodiment);
        let mocap = |name| model.mocap(name);
        let start_joints = parts
            .start_joints
            .iter()
            .map(|&(name, position)| Ok((model.joint_qpos_address(model.joint(name)?), position)));
        Ok(Self {
            layout,
            group,
            embodiment,
            hand_start: settling.hand_start,
            decoy: decoy(&model),
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
            settled: settle(&model, &settling)?,
            model,
        })
    }

    /// The state with open fingers from which every episode starts: at rest, or where Meta-World's reset leaves it.
    pub fn settled(&self) -> &State {
        &self.settled
    }

    /// What tells this scene from others.
    pub(crate) fn key(&self) -> (Layout, Embodiment, TaskGroup) {
        (self.layout, self.embodiment, self.group)
    }

    /// Draws where an episode puts things.
    pub fn place(&self, rng: &mut ChaCha8Rng) -> Placement {
        match self.layout {
            Layout::Symmetric => self.group.task().place(rng),
            Layout::MetaWorld => self.group.task().place_stock(rng),
        }
    }
}

fn compile(
    layout: Layout,
    group: TaskGroup,
    embodiment: Embodiment,
    camera: &Camera,
) -> Result<Model, EnvError> {
    let mut parts = vec![ARENA, GRIPPER, layout.embodiment(embodiment)];
    parts.extend(group.task().parts().scene);
    parts.extend(layout.addition(group));
    let includes: String = parts
        .iter()
        .map(|(name, _)| format!("<include file=\"{name}\"/>"))
        .collect();
    let main = format!("<mujoco>{includes}{}</mujoco>", camera.to_mjcf("top"));
    parts.push((MAIN, &main));
    // what the parts above include by name
    parts.extend(embodiment.included());
    parts.extend(layout.included());
    let files: Vec<(&str, &[u8])> = parts
        .iter()
        .map(|&(name, text)| (name, text.as_bytes()))
        .collect();
    Ok(Model::from_files(MAIN, &files)?)
}

fn decoy(model: &Model) -> Option<usize> {
    let joint = model.joint("decoy").ok()?;
    Some(model.joint_qpos_address(joint))
}

fn settle(model: &Arc<Model>, settling: &Settling) -> Result<State, EnvError> {
    let mut data = Data::new(Arc::clone(model));
    for &(name, position) in &settling.posture {
        let address = model.joint_qpos_address(model.joint(name)?);
        data.qpos_mut()[address] = position;
    }
    let hand_start = settling.hand_start.to_array();
    data.set_mocap_position(model.mocap("hand_target")?, hand_start)?;
    data.set_ctrl(&OPEN_FINGERS)?;
    data.step(settling.steps)?;
    Ok(data.save())
}

/// Controls of the two finger actuators that hold the gripper open.
const OPEN_FINGERS: [f64; 2] = [-1.0, 1.0];
