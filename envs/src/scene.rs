//! Compiled scene: arena, embodiment and task in one model, with the ids that the environment
//! reads.

use std::sync::Arc;

use glam::{DVec2, DVec3};
use mujoco::{BodyId, CameraId, Data, JointId, JointType, MocapId, Model, SiteId, State};
use rand_chacha::ChaCha8Rng;
use symmetry::D2;

use crate::actuation::{HandActuation, ServoArmController};
use crate::camera::Camera;
use crate::control::{ControlSettings, PHYSICS_STEP, PHYSICS_STEPS_PER_CONTROL_STEP};
use crate::embodiment::Embodiment;
use crate::error::{EnvError, require};
use crate::instance_id::InstanceId;
use crate::layout::{HAND_TARGET_START, Layout, map_point, mirrors_objects, orientation_quat};
use crate::mjcf::{Mjcf, part};
use crate::task::{MetaWorldTaskSettings, Placement, TaskGroup, TaskSceneParts};

/// Number of the MuJoCo geom group of the arm's and the gripper's geoms, which learners do not see.
pub const ARM_GEOM_GROUP: usize = 3;

/// Name of the main MJCF file of a scene, which includes the parts.
const MAIN: &str = "scene.xml";
/// Names of the MJCF files with the task's parts.
const TASK: &str = "task.xml";
const ADDITION: &str = "addition.xml";
const ARENA: Mjcf<'static> = part!("arena.xml");
/// Parts that files of tasks and layouts include.
const OBJECTS: [Mjcf<'static>; 2] = [part!("button_box.xml"), part!("peg_channel.xml")];
/// Name of the MJCF file with the embodiment's part.
const EMBODIMENT: &str = "embodiment.xml";

/// Compiled model of one task group with one embodiment in one layout, and the state in which
/// episodes start. Any number of environments share it.
#[derive(Debug)]
pub struct Scene {
    /// Layout (geometry) that the scene follows.
    pub layout: Layout,
    /// Task group that the scene is made for.
    pub group: TaskGroup,
    /// Embodiment that acts in the scene.
    pub embodiment: Embodiment,
    /// Compiled MuJoCo model of the scene.
    pub model: Arc<Model>,
    /// Model with mirrored objects, for tasks whose objects are handed.
    pub(crate) mirrored_model: Option<Arc<Model>>,
    /// Camera above the centre of the table.
    pub camera: Camera,
    pub(crate) camera_id: CameraId,
    /// Camera beside the table, for viewers.
    pub(crate) perspective_id: CameraId,
    /// Lowest and highest corner of the box that holds the hand's target (metres).
    pub(crate) target_bounds: [DVec3; 2],
    /// Meta-World's settings of the task, if the layout follows them.
    meta_world: Option<MetaWorldTaskSettings<'static>>,
    pub(crate) hand: BodyId,
    pub(crate) claw_bodies: [BodyId; 2],
    pub(crate) tip_sites: [SiteId; 2],
    pub(crate) hand_target: MocapId,
    pub(crate) object: Option<MocapId>,
    pub(crate) goal: Option<MocapId>,
    pub(crate) object_body: Option<BodyId>,
    /// Body of the task's second point.
    pub(crate) tip_body: Option<BodyId>,
    /// Bodies whose y the fingers' pads have: the pads, or the claws of hands without them.
    pub(crate) pad_bodies: [BodyId; 2],
    /// Offset from the origin of `object_body` to the task's reference point (metres, canonical
    /// frame).
    pub(crate) object_offset: DVec3,
    pub(crate) goal_observable: bool,
    /// Addresses in `qpos` and start positions of the joints that do not start at zero.
    pub(crate) start_joints: Vec<(usize, f64)>,
    /// Free joint of the task's object, if it is loose.
    pub(crate) loose_joint: Option<LooseJoint>,
    /// Address in `qpos` of the position of Meta-World's loose cylinder, if the scene has it.
    pub(crate) decoy_qpos_address: Option<usize>,
    /// Position of the hand's target when an episode starts (metres, canonical frame).
    pub(crate) hand_target_start: DVec3,
    /// Start of the episodes of each variant, in the order of [`D2::ALL`], or of all variants.
    starts: Vec<HandStart>,
}

/// State in which episodes start, with the hand at its target.
#[derive(Debug)]
pub(crate) struct HandStart {
    /// State of the simulation, without the placement of objects.
    pub state: State,
    /// Controller of an arm with servos; `None` if a weld moves the hand.
    pub controller: Option<ServoArmController>,
}

impl Scene {
    /// Compiles the scene of `group` in the symmetric layout and simulates it until it is at rest.
    ///
    /// # Errors
    /// [`EnvError::InvalidSetting`] for an invalid camera, an offset or joint position that is not
    /// finite, MJCF that changes options of the whole scene, a hand target out of bounds, a start
    /// joint that is neither a slide joint nor a hinge, a loose joint that is not free or is beside
    /// a mocap body `object`, or a handed task without objects; [`EnvError::InvalidTaskName`],
    /// [`EnvError::InvalidEmbodimentName`], or MuJoCo's error for the model.
    pub fn new(group: TaskGroup, embodiment: Embodiment, camera: Camera) -> Result<Self, EnvError> {
        Self::new_in_layout(Layout::Symmetric, group, embodiment, camera)
    }

    /// Compiles the scene of `group` in `layout` and simulates it to the start of its episodes.
    ///
    /// # Errors
    /// Errors of [`Scene::new`], and [`EnvError::NoSuchLayout`].
    pub fn new_in_layout(
        layout: Layout,
        group: TaskGroup,
        embodiment: Embodiment,
        camera: Camera,
    ) -> Result<Self, EnvError> {
        // settings are checked before MuJoCo compiles, so that errors name the setting
        camera.check()?;
        group.check_name()?;
        embodiment.check_name()?;
        let meta_world = layout.meta_world_settings(group)?;
        let parts = group.identity_task().parts();
        let of_task = parts.hand_target.unwrap_or(HAND_TARGET_START);
        let hand_target_start = meta_world.map_or(of_task, |spec| spec.hand_target);
        let mut target_bounds = layout.hand_target_bounds();
        if let Some(spec) = &meta_world {
            target_bounds[0].z = spec.lowest_target;
        }
        let of_meta_world = meta_world.map_or(&[][..], |spec| spec.start_joints);
        // the layout's come last and win over the task's own
        let start_joints = [parts.start_joints, of_meta_world].concat();
        check_parts(&parts, &start_joints, hand_target_start, target_bounds)?;
        let model = Arc::new(compile(layout, group, embodiment, &camera)?);
        let mocap = |name| model.mocap_body(name);
        let mirrored_model = mirrored(&model, &parts, layout)?;
        let models = [&model, mirrored_model.as_ref().unwrap_or(&model)];
        Ok(Self {
            layout,
            group,
            embodiment,
            target_bounds,
            meta_world,
            decoy_qpos_address: meta_world.map_or(Ok(None), |spec| decoy(&model, &spec))?,
            camera,
            camera_id: model.camera("top")?,
            perspective_id: model.camera("perspective")?,
            hand: model.body("hand")?,
            claw_bodies: [model.body("right_claw")?, model.body("left_claw")?],
            tip_sites: [model.site("right_tip")?, model.site("left_tip")?],
            hand_target: mocap("hand_target")?,
            object: parts
                .mjcf
                .filter(|_| parts.loose_joint.is_none())
                .map(|_| mocap("object"))
                .transpose()?,
            loose_joint: loose_joint(&model, &parts)?,
            tip_body: parts.tip_body.map(|name| model.body(name)).transpose()?,
            pad_bodies: [pad(&model, "right")?, pad(&model, "left")?],
            // a scene may lack the body `goal`, but one that exists must be a mocap body
            goal: model.body("goal").ok().map(|_| mocap("goal")).transpose()?,
            object_body: parts.object_body.map(|name| model.body(name)).transpose()?,
            object_offset: parts.object_offset,
            goal_observable: parts.goal_observable,
            start_joints: addresses(&model, &start_joints)?,
            hand_target_start,
            starts: HandStart::of_variants(models, layout, embodiment, hand_target_start)?,
            mirrored_model,
            model,
        })
    }

    /// Returns `true` if the pictures of variants are mirror images of each other bit for bit.
    pub(crate) fn mirrors_exactly(&self) -> bool {
        self.embodiment.mirrors_exactly() && self.camera.is_aligned()
    }

    /// Returns the simulation state in which every episode of the variant `element` starts, with
    /// open fingers: at rest, or as Meta-World's reset leaves it. A variant that the layout does not
    /// have starts as the identity does.
    pub fn start_state(&self, element: D2) -> &State {
        &self.start(element).state
    }

    pub(crate) fn start(&self, element: D2) -> &HandStart {
        self.starts.get(element.bits()).unwrap_or(&self.starts[0])
    }

    /// Returns the key of the scene: everything besides the state that determines the future of an
    /// episode.
    pub(crate) fn key(&self, control: ControlSettings) -> SceneKey {
        SceneKey {
            layout: self.layout,
            embodiment: self.embodiment,
            group: self.group,
            instance_ids: [self.group.instance_id(), self.embodiment.instance_id()],
            control,
        }
    }

    /// Draws a random placement of object and goal from the task's distribution.
    pub fn sample_placement(&self, rng: &mut ChaCha8Rng) -> Placement {
        match &self.meta_world {
            None => self.group.identity_task().sample_placement(rng),
            Some(spec) => (spec.sample_placement)(rng),
        }
    }
}

/// Key of a scene: simulations with equal keys can exchange their states.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct SceneKey {
    layout: Layout,
    embodiment: Embodiment,
    group: TaskGroup,
    /// Instance ids of task and embodiment.
    instance_ids: [InstanceId; 2],
    control: ControlSettings,
}

impl SceneKey {
    /// Returns a description of the key for an error message. If `other` has equal names but
    /// another definition behind one, it says so.
    pub(crate) fn describe(&self, other: &Self) -> String {
        let [other_task, other_embodiment] =
            [0, 1].map(|of| self.instance_ids[of] != other.instance_ids[of]);
        let remark = |differs, what| {
            if differs { format!(" (another {what} of that name)") } else { String::new() }
        };
        let of_task = remark(self.group == other.group && other_task, "task");
        let is_other = self.embodiment == other.embodiment && other_embodiment;
        let of_embodiment = remark(is_other, "embodiment");
        let Self { layout, embodiment, group, control, .. } = self;
        format!("{group}{of_task} with {embodiment}{of_embodiment}, {layout}, {control:?}")
    }
}

/// Rejects placements with coordinates that are NaN or infinite.
pub(crate) fn check_placement(placement: &Placement) -> Result<(), EnvError> {
    for (what, value) in [("object", placement.object), ("goal", placement.goal)] {
        if !value.is_finite() {
            return Err(EnvError::NonFinitePlacement { what, value });
        }
    }
    Ok(())
}

/// Rejects task parts with values that would lead to measurements and rewards that are NaN.
fn check_parts(
    parts: &TaskSceneParts<'_>,
    start_joints: &[(&str, f64)],
    hand_target: DVec3,
    [lowest, highest]: [DVec3; 2],
) -> Result<(), EnvError> {
    let offset = parts.object_offset;
    let expected = "finite numbers of metres";
    require(offset.is_finite(), "object_offset", &offset, expected)?;
    for element in ["<compiler", "<option"] {
        let is_missing = !parts.mjcf.is_some_and(|mjcf| mjcf.contains(element));
        let expected_mjcf = "neither `<compiler` nor `<option`, which change the whole scene: \
                             angles are in radians, and a physics step takes 2.5 ms";
        require(is_missing, "mjcf", &format!("with `{element}`"), expected_mjcf)?;
    }
    let is_inside = hand_target.cmpge(lowest).all() && hand_target.cmple(highest).all();
    let expected_place = "a place within the bounds of the hand's target";
    require(is_inside, "hand_target", &hand_target, expected_place)?;
    for (joint, position) in start_joints {
        let value = format!("{position} for the joint `{joint}`");
        let expected_position = "finite positions";
        require(position.is_finite(), "start_joints", &value, expected_position)?;
    }
    Ok(())
}

fn compile(
    layout: Layout,
    group: TaskGroup,
    embodiment: Embodiment,
    camera: &Camera,
) -> Result<Model, EnvError> {
    let addition = layout.meta_world_settings(group)?.and_then(|spec| spec.extra_mjcf);
    let embodiment_parts = embodiment.spec().parts()?;
    let meta_world_mjcf = layout.meta_world_mjcf(embodiment.spec());
    let mut parts: Vec<Mjcf<'_>> =
        vec![ARENA, (EMBODIMENT, meta_world_mjcf.unwrap_or(&embodiment_parts.mjcf))];
    parts.extend(group.identity_task().parts().mjcf.map(|text| (TASK, text)));
    parts.extend(addition.map(|text| (ADDITION, text)));
    let include = |(name, _): &Mjcf<'_>| format!("<include file=\"{name}\"/>");
    let includes: String = parts.iter().map(include).collect();
    let main = format!("<mujoco>{includes}{}</mujoco>", camera.to_mjcf("top"));
    parts.push((MAIN, &main));
    // the files that the parts above include by name
    parts.extend(embodiment_parts.included_files.iter().map(|(name, text)| (*name, &text[..])));
    parts.extend(OBJECTS);
    parts.extend(layout.included_files());
    let files: Vec<(&str, &[u8])> =
        parts.iter().map(|&(name, text)| (name, text.as_bytes())).collect();
    let model = Model::from_files(MAIN, &files)?;
    let timestep = model.timestep();
    let expected = "0.0025 seconds, on which control steps and rewards rest";
    require(timestep == PHYSICS_STEP, "timestep", &timestep, expected)?;
    Ok(model)
}

/// Returns the model with mirrored objects, if they are handed and the layout has variants that
/// mirror them.
fn mirrored(
    model: &Model,
    parts: &TaskSceneParts<'_>,
    layout: Layout,
) -> Result<Option<Arc<Model>>, EnvError> {
    if !parts.handed {
        return Ok(None);
    }
    // a scene lacks `object` if its object is loose, and it may lack `goal`
    let placed = ["object", "goal"].into_iter().filter_map(|name| model.body(name).ok());
    let loose = parts.loose_joint.map(|name| model.joint(name)).transpose()?;
    let roots: Vec<_> = placed.chain(loose.map(|joint| model.joint_body(joint))).collect();
    let expected = "false, or a scene with a body `object` or `goal`, or a loose joint";
    require(!roots.is_empty(), "handed", &true, expected)?;
    if layout.group_elements().len() == 1 {
        return Ok(None);
    }
    Ok(Some(Arc::new(model.with_mirrored_bodies(&roots)?)))
}

/// Addresses of the free joint of a task's loose object in the simulation's state.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LooseJoint {
    /// Address in `qpos` of position (3) and orientation (4).
    pub qpos: usize,
    /// Address in `qvel` of linear and angular velocity (3 each).
    pub qvel: usize,
}

fn loose_joint(model: &Model, parts: &TaskSceneParts<'_>) -> Result<Option<LooseJoint>, EnvError> {
    let Some(name) = parts.loose_joint else { return Ok(None) };
    let joint = model.joint(name)?;
    require_free(model, joint, "loose_joint", name)?;
    let beside = format!("`{name}` beside a mocap body `object`");
    require(model.mocap_body("object").is_err(), "loose_joint", &beside, "one of the two")?;
    let (qpos, qvel) = (model.joint_qpos_address(joint), model.joint_dof_address(joint));
    Ok(Some(LooseJoint { qpos, qvel }))
}

fn require_free(
    model: &Model,
    joint: JointId,
    what: &'static str,
    name: &str,
) -> Result<(), EnvError> {
    let joint_type = model.joint_type(joint);
    let value = format!("`{name}` of type {joint_type:?}");
    require(joint_type == JointType::Free, what, &value, "a free joint")
}

/// Returns the body of the pad on a side of the gripper, or of the claw if it has none.
fn pad(model: &Model, side: &str) -> Result<BodyId, EnvError> {
    let claw = || model.body(&format!("{side}_claw"));
    Ok(model.body(&format!("{side}_pad")).or_else(|_| claw())?)
}

fn addresses(model: &Model, joints: &[(&str, f64)]) -> Result<Vec<(usize, f64)>, EnvError> {
    let address = |&(name, position): &(&str, f64)| {
        let joint = model.joint(name)?;
        let joint_type = model.joint_type(joint);
        let has_one_coordinate = matches!(joint_type, JointType::Slide | JointType::Hinge);
        let value = format!("`{name}` of type {joint_type:?}");
        require(has_one_coordinate, "start_joints", &value, "slide joints and hinges")?;
        Ok((model.joint_qpos_address(joint), position))
    };
    joints.iter().map(address).collect()
}

/// Returns the address in `qpos` of the loose cylinder of Meta-World's reach task, if the scene has
/// it. A task's own joint called `decoy` is left alone.
fn decoy(model: &Model, spec: &MetaWorldTaskSettings<'_>) -> Result<Option<usize>, EnvError> {
    let joint = spec.extra_mjcf.and_then(|_| model.joint("decoy").ok());
    let Some(joint) = joint else { return Ok(None) };
    require_free(model, joint, "extra_mjcf", "decoy")?;
    Ok(Some(model.joint_qpos_address(joint)))
}

impl HandStart {
    /// Returns the starts of all variants of a layout, or one where the hand is on the axis of all
    /// symmetries; `models` are the plain one and that of mirrored objects.
    fn of_variants(
        models: [&Arc<Model>; 2],
        layout: Layout,
        embodiment: Embodiment,
        hand_target: DVec3,
    ) -> Result<Vec<Self>, EnvError> {
        let is_central = hand_target.truncate() == DVec2::ZERO;
        let elements = if is_central { &[D2::Identity] } else { layout.group_elements() };
        let start = |&element: &D2| {
            let model = models[usize::from(mirrors_objects(element))];
            Self::settle(model, layout, embodiment, element, hand_target)
        };
        elements.iter().map(start).collect()
    }

    /// Simulates `model` to the state in which the episodes of the variant `element` start, with
    /// the hand's target at `hand_target` (metres, canonical frame).
    fn settle(
        model: &Arc<Model>,
        layout: Layout,
        embodiment: Embodiment,
        element: D2,
        hand_target: DVec3,
    ) -> Result<Self, EnvError> {
        let spec = embodiment.spec();
        let settling = layout.settling(map_point(element, hand_target), spec)?;
        let mut data = Data::new(Arc::clone(model));
        for (name, position) in &settling.joint_positions {
            let address = model.joint_qpos_address(model.joint(name)?);
            data.qpos_mut()[address] = *position;
        }
        if let Ok(object) = model.mocap_body("object") {
            // otherwise the hand could touch the object of another variant
            let place = map_point(element, DVec3::from_array(data.mocap_position(object)));
            data.set_mocap_position(object, place.to_array())?;
            data.set_mocap_orientation(object, orientation_quat(element))?;
        }
        let target = settling.hand_target.to_array();
        data.set_mocap_position(model.mocap_body("hand_target")?, target)?;
        let controller = match spec.actuation()? {
            HandActuation::Weld => {
                data.set_all_ctrl(&OPEN_FINGERS)?;
                data.step(settling.steps)?;
                None
            }
            HandActuation::Servos(mut controller) => {
                controller.start(model, &settling.joint_positions)?;
                for _ in 0..SERVOS_SETTLED {
                    controller.advance(&mut data, settling.hand_target, OPEN_ACTION)?;
                    data.step(PHYSICS_STEPS_PER_CONTROL_STEP)?;
                }
                Some(*controller)
            }
        };
        Ok(Self { state: data.save_state(), controller })
    }
}

/// Number of control steps in which servos come to rest, in any layout: 1 s.
const SERVOS_SETTLED: usize = 80;
/// Finger action that opens the gripper.
const OPEN_ACTION: f64 = -1.0;

/// Controls of the two finger actuators that keep the gripper open.
const OPEN_FINGERS: [f64; 2] = [-1.0, 1.0];
