//! A compiled scene: arena, embodiment and task in one model, with the ids that the environment
//! reads.

use std::sync::Arc;

use glam::DVec3;
use mujoco::{BodyId, CameraId, Data, MocapId, Model, SiteId, State};
use rand_chacha::ChaCha8Rng;

use crate::camera::Camera;
use crate::control::{Control, PHYSICS_STEPS};
use crate::drive::{Drive, ServoDrive};
use crate::embodiment::Embodiment;
use crate::error::{EnvError, require};
use crate::identity::Identity;
use crate::layout::{HAND_START, Layout, Settling};
use crate::mjcf::{Mjcf, part};
use crate::task::{Parts, Placement, Stock, TaskGroup};

/// Geom group of the arm and the gripper.
pub const ARM_GEOM_GROUP: usize = 3;

/// File name of the scene that includes the parts.
const MAIN: &str = "scene.xml";
/// File names of what the task brings.
const TASK: &str = "task.xml";
const ADDITION: &str = "addition.xml";
const ARENA: Mjcf<'static> = part!("arena.xml");
/// File name of what the embodiment brings.
const CARRIER: &str = "embodiment.xml";

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
    pub(crate) hand_target_start: DVec3,
    /// Meta-World's figures, in the layout that follows them.
    stock: Option<Stock<'static>>,
    pub(crate) hand: BodyId,
    pub(crate) claws: [BodyId; 2],
    pub(crate) tips: [SiteId; 2],
    pub(crate) hand_target: MocapId,
    pub(crate) object: Option<MocapId>,
    pub(crate) goal: Option<MocapId>,
    pub(crate) object_body: Option<BodyId>,
    /// From that body's origin to the point that the task speaks of (metres, canonical frame).
    pub(crate) object_offset: DVec3,
    pub(crate) goal_observable: bool,
    /// Addresses in `qpos` and positions of the joints that an episode starts away from zero.
    pub(crate) start_joints: Vec<(usize, f64)>,
    /// Address in `qpos` of the loose cylinder's position, where there is one.
    pub(crate) decoy: Option<usize>,
    /// The state from which every episode starts.
    pub(crate) settled: State,
    /// What moves the arm there, if no weld does.
    pub(crate) drive: Option<ServoDrive>,
}

impl Scene {
    /// Compiles the scene of `group` in the symmetric layout and lets it come to rest.
    ///
    /// # Errors
    /// [`EnvError::Setting`] for an impossible camera, or an offset or start of a joint that is not
    /// finite; [`EnvError::TaskName`], or what MuJoCo says of the model.
    pub fn new(group: TaskGroup, embodiment: Embodiment, camera: Camera) -> Result<Self, EnvError> {
        Self::in_layout(Layout::Symmetric, group, embodiment, camera)
    }

    /// Compiles the scene of `group` in `layout` and brings it to where its episodes start.
    ///
    /// # Errors
    /// As [`Scene::new`], and [`EnvError::NoSuchLayout`].
    pub fn in_layout(
        layout: Layout,
        group: TaskGroup,
        embodiment: Embodiment,
        camera: Camera,
    ) -> Result<Self, EnvError> {
        camera.check()?;
        group.check_name()?;
        embodiment.check_name()?;
        let stock = layout.stock(group)?;
        let hand_target_start = stock.map_or(HAND_START, |stock| stock.hand_target);
        let settling = layout.settling(hand_target_start, embodiment.carrier())?;
        let parts = group.task().parts();
        check_parts(&parts)?;
        let model = Arc::new(compile(layout, group, embodiment, &camera)?);
        let mocap = |name| model.mocap(name);
        let (settled, drive) = settle(&model, &settling, embodiment.carrier().drive()?)?;
        Ok(Self {
            layout,
            group,
            embodiment,
            hand_target_start,
            stock,
            decoy: stock.and_then(|stock| decoy(&model, &stock)),
            camera,
            camera_id: model.camera("top")?,
            hand: model.body("hand")?,
            claws: [model.body("right_claw")?, model.body("left_claw")?],
            tips: [model.site("right_tip")?, model.site("left_tip")?],
            hand_target: mocap("hand_target")?,
            object: parts.mjcf.map(|_| mocap("object")).transpose()?,
            goal: model.body("goal").ok().map(|_| mocap("goal")).transpose()?,
            object_body: parts.object_body.map(|name| model.body(name)).transpose()?,
            object_offset: parts.object_offset,
            goal_observable: parts.goal_observable,
            start_joints: addresses(&model, parts.start_joints)?,
            settled,
            drive,
            model,
        })
    }

    /// The state with open fingers from which every episode starts: at rest, or where Meta-World's
    /// reset leaves it.
    pub fn settled(&self) -> &State {
        &self.settled
    }

    /// What the future of an episode depends on, beside its state.
    pub(crate) fn key(&self, control: Control) -> SceneKey {
        SceneKey {
            layout: self.layout,
            embodiment: self.embodiment,
            group: self.group,
            identities: [self.group.identity(), self.embodiment.identity()],
            control,
        }
    }

    /// Draws where an episode puts things.
    pub fn place(&self, rng: &mut ChaCha8Rng) -> Placement {
        match &self.stock {
            None => self.group.task().place(rng),
            Some(stock) => (stock.place)(rng),
        }
    }
}

/// What tells simulations apart whose states do not fit one another.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct SceneKey {
    layout: Layout,
    embodiment: Embodiment,
    group: TaskGroup,
    /// Of task and embodiment.
    identities: [Identity; 2],
    control: Control,
}

impl SceneKey {
    /// In words, beside those of `other`: where the names are one, it says whether the things are.
    pub(crate) fn words(&self, other: &Self) -> String {
        let [task, carrier] = [0, 1].map(|of| self.identities[of] != other.identities[of]);
        let remark = |differs, what| {
            if differs { format!(" (another {what} of that name)") } else { String::new() }
        };
        let of_task = remark(self.group == other.group && task, "task");
        let of_carrier = remark(self.embodiment == other.embodiment && carrier, "embodiment");
        let Self { layout, embodiment, group, control, .. } = self;
        format!("{group}{of_task} with {embodiment}{of_carrier}, {layout}, {control:?}")
    }
}

/// Refuses places that are not finite.
pub(crate) fn check_placement(placement: &Placement) -> Result<(), EnvError> {
    for (what, value) in [("object", placement.object), ("goal", placement.goal)] {
        if !value.is_finite() {
            return Err(EnvError::NonFinitePlacement { what, value });
        }
    }
    Ok(())
}

/// Refuses figures that would make measurements and rewards that are not numbers.
fn check_parts(parts: &Parts<'_>) -> Result<(), EnvError> {
    let offset = parts.object_offset;
    let expected = "finite numbers of metres";
    require(offset.is_finite(), "object_offset", &offset, expected)?;
    for (joint, position) in parts.start_joints {
        let value = format!("{position} for the joint `{joint}`");
        let expected = "finite positions";
        require(position.is_finite(), "start_joints", &value, expected)?;
    }
    Ok(())
}

fn compile(
    layout: Layout,
    group: TaskGroup,
    embodiment: Embodiment,
    camera: &Camera,
) -> Result<Model, EnvError> {
    let addition = layout.stock(group)?.and_then(|stock| stock.addition);
    let carrier = embodiment.carrier().parts()?;
    let stock = layout.stock_carrier(embodiment.carrier());
    let mut parts: Vec<Mjcf<'_>> = vec![ARENA, (CARRIER, stock.unwrap_or(&carrier.mjcf))];
    parts.extend(group.task().parts().mjcf.map(|text| (TASK, text)));
    parts.extend(addition.map(|text| (ADDITION, text)));
    let include = |(name, _): &Mjcf<'_>| format!("<include file=\"{name}\"/>");
    let includes: String = parts.iter().map(include).collect();
    let main = format!("<mujoco>{includes}{}</mujoco>", camera.to_mjcf("top"));
    parts.push((MAIN, &main));
    // what the parts above include by name
    parts.extend(carrier.included.iter().map(|(name, text)| (*name, &text[..])));
    parts.extend(layout.included());
    let files: Vec<(&str, &[u8])> =
        parts.iter().map(|&(name, text)| (name, text.as_bytes())).collect();
    Ok(Model::from_files(MAIN, &files)?)
}

/// Addresses in `qpos` of joints, and their positions.
fn addresses(model: &Model, joints: &[(&str, f64)]) -> Result<Vec<(usize, f64)>, EnvError> {
    let address = |&(name, position)| Ok((model.joint_qpos_address(model.joint(name)?), position));
    joints.iter().map(address).collect()
}

/// The joint of the loose cylinder that a stock addition brings. A task's own joint of that name is
/// left alone.
fn decoy(model: &Model, stock: &Stock<'_>) -> Option<usize> {
    stock.addition?;
    let joint = model.joint("decoy").ok()?;
    Some(model.joint_qpos_address(joint))
}

/// The state from which episodes start, and what moves an arm from there on.
fn settle(
    model: &Arc<Model>,
    settling: &Settling,
    drive: Drive,
) -> Result<(State, Option<ServoDrive>), EnvError> {
    let mut data = Data::new(Arc::clone(model));
    for (name, position) in &settling.posture {
        let address = model.joint_qpos_address(model.joint(name)?);
        data.qpos_mut()[address] = *position;
    }
    let hand_target = settling.hand_target.to_array();
    data.set_mocap_position(model.mocap("hand_target")?, hand_target)?;
    let drive = match drive {
        Drive::Weld => {
            data.set_ctrl(&OPEN_FINGERS)?;
            data.step(settling.steps)?;
            None
        }
        Drive::Servos(mut drive) => {
            drive.start(model, &settling.posture)?;
            for _ in 0..SERVOS_SETTLED {
                drive.advance(&mut data, settling.hand_target, OPENS)?;
                data.step(PHYSICS_STEPS)?;
            }
            Some(*drive)
        }
    };
    Ok((data.save(), drive))
}

/// Control steps in which servos come to rest, in any layout: a second.
const SERVOS_SETTLED: usize = 80;
/// The finger action that opens the gripper.
const OPENS: f64 = -1.0;

/// Controls of the two finger actuators that hold the gripper open.
const OPEN_FINGERS: [f64; 2] = [-1.0, 1.0];
