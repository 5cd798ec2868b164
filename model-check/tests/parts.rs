//! Meshes, cameras, sensors, corrections and maps.

use std::path::Path;
use std::sync::Arc;

use model_check::{
    MirrorPlane, ModelSymmetryReport, ModelSymmetrySettings, PlaneAndPairCorrections,
    check_model_symmetry, read_model,
};
use mujoco::{Data, Model};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

fn checked(xml: &str, corrections: PlaneAndPairCorrections) -> ModelSymmetryReport {
    let model = Model::from_xml(xml).unwrap();
    check_model_symmetry(
        &model,
        &ModelSymmetrySettings { corrections, simulates: false, ..Default::default() },
    )
    .unwrap()
}

fn properties(found: &ModelSymmetryReport) -> Vec<String> {
    found.differences.iter().map(|d| format!("{} {}", d.kind, d.property)).collect()
}

/// Two wheels with a mesh each, whose vertices are given, at the sides of a cart with a camera.
fn cart(left: &str, right: &str, camera: &str, fovy: &str) -> String {
    format!(
        "<mujoco><asset><mesh name='l' vertex='{left}'/><mesh name='r' vertex='{right}'/></asset>\
         <worldbody><body name='cart'><freejoint/><geom type='sphere' size='0.1'/>\
         <camera name='eye_l' pos='0.1 0.05 0' {camera}/>\
         <camera name='eye_r' pos='0.1 -0.05 0' {camera} fovy='{fovy}'/>\
         <body name='l' pos='0 0.2 0'><joint name='l' axis='0 1 0'/><geom type='mesh' mesh='l'/>\
         </body><body name='r' pos='0 -0.2 0'><joint name='r' axis='0 1 0'/>\
         <geom type='mesh' mesh='r'/></body></body></worldbody></mujoco>"
    )
}

const LEFT: &str = "0 0 0  0.1 0 0  0 0.05 0  0 0 0.07";
const RIGHT: &str = "0 0 0  0.1 0 0  0 -0.05 0  0 0 0.07";
const AHEAD: &str = "xyaxes='0 -1 0 0 0 1'";

#[test]
fn a_mesh_that_is_not_mirrored_is_named_with_its_inertia() {
    let sound = checked(&cart(LEFT, RIGHT, AHEAD, "45"), PlaneAndPairCorrections::default());
    assert_eq!(properties(&sound), [""; 0], "{}", sound.text());
    let copied = checked(&cart(LEFT, LEFT, AHEAD, "45"), PlaneAndPairCorrections::default());
    let properties = properties(&copied);
    for expected in ["geom position", "body centre of mass", "body inertia"] {
        assert!(properties.contains(&expected.to_owned()), "{expected}: {properties:?}");
    }
}

#[test]
fn cameras_are_compared_and_can_be_ignored() {
    let narrow = cart(LEFT, RIGHT, AHEAD, "40");
    let found = checked(&narrow, PlaneAndPairCorrections::default());
    assert_eq!(properties(&found), ["camera field of view"], "{}", found.text());
    let ignore = vec!["camera eye_r".to_owned()];
    let ignored =
        checked(&narrow, PlaneAndPairCorrections { ignore, ..PlaneAndPairCorrections::default() });
    assert_eq!(properties(&ignored), [""; 0]);
    // both look to the left
    let aside = checked(
        &cart(LEFT, RIGHT, "xyaxes='1 0 0 0 0 1'", "45"),
        PlaneAndPairCorrections::default(),
    );
    assert_eq!(properties(&aside), ["camera orientation"], "{}", aside.text());
}

/// Two legs of a walker, each of a hinge and a ball, and what is wrong with corrections of them.
#[test]
fn corrections_that_cannot_be_meant_are_refused() {
    let leg = |side: &str, y: f64| {
        format!(
            "<body name='{side}_leg' pos='0 {y} 0'><joint name='{side}_hip' axis='0 1 0'/>\
             <geom size='0.05'/><body name='{side}_foot' pos='0 0 -0.2'>\
             <joint name='{side}_ankle' type='ball'/><geom size='0.05'/></body></body>"
        )
    };
    let legs = [leg("left", 0.2), leg("right", -0.2)].concat();
    let xml = format!(
        "<mujoco><worldbody><body name='trunk'><geom size='0.1'/>{legs}</body>\
        </worldbody></mujoco>"
    );
    let model = Model::from_xml(&xml).unwrap();
    for (pairs, says) in [
        (r#"{"joint": [["left_hip", "right_ankle"]]}"#, "their types differ"),
        (
            r#"{"body": [["left_leg", "right_leg"], ["left_leg", "left_leg"]]}"#,
            "in another pair, too",
        ),
        (r#"{"body": [["trunk", "right_leg"]]}"#, "no counterparts"),
    ] {
        let corrections = serde_json::from_str(&format!(r#"{{"pairs": {pairs}}}"#)).unwrap();
        let settings =
            ModelSymmetrySettings { corrections, simulates: false, ..Default::default() };
        let message = check_model_symmetry(&model, &settings).unwrap_err().to_string();
        assert!(message.contains(says), "{message}");
    }
    let corrections = serde_json::from_str(r#"{"ignore": ["bdoy left_leg"]}"#).unwrap();
    let settings = ModelSymmetrySettings { corrections, simulates: false, ..Default::default() };
    let message = check_model_symmetry(&model, &settings).unwrap_err().to_string();
    assert!(message.contains("expected a kind and a name"), "{message}");
}

/// Ignored differences are not reported, and change no figure of the rest.
#[test]
fn effects_do_not_depend_on_what_is_ignored() {
    let leg = |side: &str, y: f64, mass: f64, damping: f64| {
        format!(
            "<body name='{side}_leg' pos='0 {y} 0'>\
             <joint name='{side}_hip' axis='0 1 0' damping='{damping}'/>\
             <geom size='0.05' mass='{mass}' pos='0 0 -0.2'/></body>"
        )
    };
    let legs = [leg("left", 0.2, 1.0, 0.1), leg("right", -0.2, 1.5, 0.2)].concat();
    let xml = format!(
        "<mujoco><worldbody><body name='trunk'><freejoint/><geom size='0.1'/>{legs}\
        </body></worldbody></mujoco>"
    );
    let model = Model::from_xml(&xml).unwrap();
    let effects = |ignore: &[&str]| {
        let ignore = ignore.iter().map(|&name| name.to_owned()).collect();
        let corrections = PlaneAndPairCorrections { ignore, ..Default::default() };
        let settings = ModelSymmetrySettings { corrections, ..Default::default() };
        let found = check_model_symmetry(&model, &settings).unwrap();
        let mut damping = found.differences.iter().filter(|d| d.property.contains("damping"));
        (found.twin_divergence, damping.next().unwrap().effect, found.differences.len())
    };
    let (twins, effect, all) = effects(&[]);
    assert!(effect.unwrap() > 0.0);
    let (same_twins, same_effect, fewer) = effects(&["body left_leg"]);
    assert!(fewer < all);
    assert_eq!((same_twins, same_effect), (twins, effect));
}

#[test]
fn two_files_of_one_name_are_refused() {
    let folder = std::env::temp_dir().join(format!("covers-twins-{}", std::process::id()));
    for side in ["left", "right"] {
        std::fs::create_dir_all(folder.join(side)).unwrap();
        let part =
            format!("<mujocoinclude><option timestep='0.00{}'/></mujocoinclude>", side.len());
        std::fs::write(folder.join(side).join("part.xml"), part).unwrap();
    }
    let model = folder.join("robot.xml");
    let with = |second: &str| {
        let xml =
            format!("<mujoco><include file='left/part.xml'/><include file='{second}'/></mujoco>");
        std::fs::write(&model, xml).unwrap();
        read_model(&model)
    };
    let message = with("right/part.xml").unwrap_err().to_string();
    std::fs::remove_dir_all(&folder).unwrap();
    assert!(message.contains("right/part.xml") && message.contains("rename one"), "{message}");
}

/// MuJoCo looks for a mesh in `meshdir` alone.
#[test]
fn a_mesh_is_read_from_the_folder_that_the_model_names() {
    let folder = std::env::temp_dir().join(format!("covers-meshdir-{}", std::process::id()));
    std::fs::create_dir_all(folder.join("meshes")).unwrap();
    let object = |size: &str| {
        format!(
            "v 0 0 0\nv {size} 0 0\nv 0 {size} 0\nv 0 0 {size}\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
        )
    };
    std::fs::write(folder.join("part.obj"), object("0.5")).unwrap();
    std::fs::write(folder.join("meshes/part.obj"), object("0.1")).unwrap();
    let model = folder.join("robot.xml");
    let xml = "<mujoco><compiler meshdir='meshes'/><asset><mesh name='part' file='part.obj'/>\
               </asset><worldbody><body><geom name='part' type='mesh' mesh='part'/></body>\
               </worldbody></mujoco>";
    std::fs::write(&model, xml).unwrap();
    let read = read_model(&model);
    std::fs::remove_dir_all(&folder).unwrap();
    let read = read.unwrap();
    let size = read.geom_size(read.geom("part").unwrap());
    assert!(size[0] < 0.1, "{size:?}");
}

#[test]
fn a_geom_on_one_side_has_no_counterpart() {
    let sound = cart(LEFT, RIGHT, AHEAD, "45");
    let pad = "<geom name='pad' size='0.01' pos='0 0.03 0'/><geom type='mesh' mesh='l'/>";
    let padded = sound
        .replace(
            "<geom type='mesh' mesh='l'/>",
            &format!("{pad}<inertial pos='0 0 0' mass='1' diaginertia='1 1 1'/>"),
        )
        .replace(
            "<geom type='mesh' mesh='r'/>",
            "<geom type='mesh' mesh='r'/><inertial pos='0 0 0' mass='1' diaginertia='1 1 1'/>",
        );
    let found = checked(&padded, PlaneAndPairCorrections::default());
    assert_eq!(found.differences.len(), 1, "{}", found.text());
    let line = found.text();
    assert!(line.contains("geom pad has no counterpart on r"), "{line}");
}

#[test]
fn maps_turn_sensor_data_into_those_of_the_mirrored_state() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/assets/models/quadruped.xml");
    let model = read_model(path.as_ref()).unwrap();
    let found = check_model_symmetry(&model, &ModelSymmetrySettings::default()).unwrap();
    assert!(found.differences.is_empty(), "{}", found.text());
    let maps = found.maps.unwrap();
    let mut rng = ChaCha8Rng::seed_from_u64(0);
    let [mut data, mut mirrored] =
        [0; 2].map(|_| Data::new(Arc::new(read_model(path.as_ref()).unwrap())));
    for _ in 0..10 {
        let mut draw =
            |len: usize| -> Vec<f64> { (0..len).map(|_| rng.random_range(-0.5..0.5)).collect() };
        let [mut qpos, qvel, ctrl] = [draw(model.nq()), draw(model.nv()), draw(model.nu())];
        let norm = qpos[3..7].iter().map(|part| part * part).sum::<f64>().sqrt();
        qpos[3..7].iter_mut().for_each(|part| *part /= norm);
        data.qpos_mut().copy_from_slice(&qpos);
        data.qvel_mut().copy_from_slice(&qvel);
        data.set_all_ctrl(&ctrl).unwrap();
        mirrored.qpos_mut().copy_from_slice(&maps.qpos.apply(&qpos));
        mirrored.qvel_mut().copy_from_slice(&maps.qvel.apply(&qvel));
        mirrored.set_all_ctrl(&maps.ctrl.apply(&ctrl)).unwrap();
        data.forward().unwrap();
        mirrored.forward().unwrap();
        let expected = maps.sensordata.as_ref().unwrap().apply(data.sensor_data());
        for (image, got) in expected.iter().zip(mirrored.sensor_data()) {
            assert!((image - got).abs() < 1e-6 * (1.0 + got.abs()), "{image} {got}");
        }
        assert!(data.sensor_data().iter().any(|value| value.abs() > 0.1));
        // channels of irreps: the even ones stay, the odd ones change sign
        let (group, flip) = (maps.group, maps.group.elements()[1]);
        let mut channels = maps.qvel.vector_to_irreps(group, &qvel);
        let back = maps.qvel.from_irreps(group, &channels);
        assert!(back.iter().zip(&qvel).all(|(a, b)| (a - b).abs() < 1e-12));
        maps.qvel.field_type(group).transform_channels(flip, &mut channels);
        let image = maps.qvel.vector_to_irreps(group, &maps.qvel.apply(&qvel));
        assert!(channels.iter().zip(&image).all(|(a, b)| (a - b).abs() < 1e-12));
    }
}

#[test]
fn a_tolerance_or_a_plane_that_would_hide_differences_is_refused() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/assets/models/quadruped.xml");
    let model = read_model(path.as_ref()).unwrap();
    let refused = |settings: ModelSymmetrySettings| {
        check_model_symmetry(&model, &settings).unwrap_err().to_string()
    };
    for tolerance in [f64::NAN, f64::INFINITY, -1e-3] {
        let message =
            refused(ModelSymmetrySettings { tolerance, ..ModelSymmetrySettings::default() });
        assert!(message.starts_with("the tolerance is"), "{message}");
    }
    let plane = |normal, offset| PlaneAndPairCorrections {
        plane: Some(MirrorPlane { normal, offset }),
        ..PlaneAndPairCorrections::default()
    };
    for corrections in
        [plane([0.0, 2.0, 0.0], 0.0), plane([f64::NAN; 3], 0.0), plane([0.0, 1.0, 0.0], f64::NAN)]
    {
        let message =
            refused(ModelSymmetrySettings { corrections, ..ModelSymmetrySettings::default() });
        assert!(message.starts_with("the plane is"), "{message}");
    }
}

#[test]
fn a_page_shows_the_model_and_escapes_its_names() {
    let quadruped = Path::new(env!("CARGO_MANIFEST_DIR")).join("assets/models/quadruped.xml");
    let xml = std::fs::read_to_string(quadruped).unwrap();
    let heavy = xml.replacen("mass=\"0.9\"", "mass=\"0.95\"", 1);
    assert_ne!(heavy, xml);
    let heavy =
        heavy.replace("FL_thigh", "FL_&lt;thigh&gt;").replace("FR_thigh", "FR_&lt;thigh&gt;");
    let model = Arc::new(Model::from_xml(&heavy).unwrap());
    let found = check_model_symmetry(&model, &ModelSymmetrySettings::default()).unwrap();
    let page = found.html("dog & cat", &model).unwrap();
    assert!(page.contains("<h1>dog &amp; cat: left and right</h1>"), "{page}");
    let row = "<td>body FL_&lt;thigh&gt; | FR_&lt;thigh&gt;</td><td>mass</td>\
               <td>differs by 5.263 %</td><td>0.95</td><td>0.9</td>";
    assert!(page.contains(row), "{page}");
    assert_eq!(page.matches("data:image/png;base64,").count(), 2);
    let effect = format!("{:.1e}", found.differences[0].effect.unwrap());
    assert!(page.contains(&format!("<td class=\"number\">{effect}</td>")), "{page}");
}

#[test]
fn a_robots_settings_lead_to_its_model() {
    let folder = std::env::temp_dir().join(format!("covers-robot-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let arm = |side: &str, y: f64| {
        format!(
            "<link name='{side}'><inertial><origin xyz='0 0.01 0.1'/><mass value='1'/>\
             <inertia ixx='.01' iyy='.01' izz='.01' ixy='0' ixz='0' iyz='0'/></inertial>\
             <collision><geometry><mesh filename='package://robot/arm.stl'/></geometry>\
             </collision></link><joint name='{side}' type='revolute'><parent link='trunk'/>\
             <child link='{side}'/><origin xyz='0 {y} 0'/><axis xyz='1 0 0'/>\
             <limit lower='-1' upper='1' effort='1' velocity='1'/></joint>"
        )
    };
    let [left, right] = [arm("arm_left", 0.2), arm("arm_right", -0.2)];
    let urdf = format!("<robot name='r'><link name='trunk'/>{left}{right}</robot>");
    std::fs::write(folder.join("robot.urdf"), urdf).unwrap();
    let settings = folder.join("robot.json");
    std::fs::write(&settings, "\u{feff}{\"urdf\": \"robot.urdf\", \"ignore_meshes\": true}")
        .unwrap();
    assert!(read_model(&folder.join("robot.urdf")).unwrap_err().to_string().contains("arm.stl"));
    let model = read_model(&settings).unwrap();
    std::fs::remove_dir_all(&folder).unwrap();
    let found = check_model_symmetry(&model, &ModelSymmetrySettings::default()).unwrap();
    // the centre of mass was copied instead of mirrored, as in public models of Talos
    let text = found.text();
    assert!(
        text.contains("body arm_left | arm_right: centre of mass differs by 20.00 mm"),
        "{text}"
    );
}

/// Two legs on ball hips, turned by a quarter, and two rotors at sites, whose motors have these
/// attributes; the right leg is turned a little further.
fn hips_and_rotors(further: f64, [hip_l, hip_r, rotor_l, rotor_r]: [&str; 4]) -> String {
    let side = |name: &str, y: f64, turn: f64| {
        format!(
            "<body name='leg_{name}' pos='0 {y} 0' axisangle='0 0 1 {turn}'>\
             <joint name='hip_{name}' type='ball'/>\
             <geom type='sphere' size='0.05' pos='0 0 -0.2'/></body>\
             <site name='rotor_{name}' pos='0 {y} 0.2'/>"
        )
    };
    let quarter = std::f64::consts::FRAC_PI_2;
    format!(
        "<mujoco><compiler angle='radian'/><worldbody><body name='trunk'><freejoint/>\
         <geom type='sphere' size='0.1'/><site name='hub' pos='0 0 0.2'/>{}{}</body></worldbody>\
         <actuator><motor name='hip_l' {hip_l}/><motor name='hip_r' {hip_r}/>\
         <motor name='rotor_l' site='rotor_l' {rotor_l}/>\
         <motor name='rotor_r' site='rotor_r' {rotor_r}/></actuator></mujoco>",
        side("l", 0.3, quarter),
        side("r", -0.3, quarter + further),
    )
}

#[test]
fn directions_of_torques_and_forces_are_mirrored() {
    let rotors = ["gear='0 0 1 0 0 0.02'", "gear='0 0 1 0 0 -0.02'"];
    let check = |hips: [&str; 2], spin: [&str; 2]| {
        let motors = [hips[0], hips[1], spin[0], spin[1]];
        checked(&hips_and_rotors(1e-5, motors), PlaneAndPairCorrections::default())
    };
    // a mirror across y reverses torques about x and z, and not forces along z; in the legs' frames
    // x is the world's y
    for joint in ["joint", "jointinparent"] {
        for (gear, sign) in [("1 0 0", 1), ("0 1 0", -1), ("0 0 1", -1)] {
            let hips = ["hip_l", "hip_r"].map(|hip| format!("{joint}='{hip}' gear='{gear}'"));
            let found = check([&hips[0], &hips[1]], rotors);
            assert_eq!(properties(&found), [""; 0], "{gear}: {}", found.text());
            assert_eq!(found.maps.unwrap().ctrl.signs, [sign, sign, 1, 1], "{joint} {gear}");
        }
    }
    let hips = ["joint='hip_l' gear='1 0 0'", "joint='hip_r' gear='1 0 0'"];
    let other_axis = [hips[0], "joint='hip_r' gear='0 1 0'"];
    let same_spin = [rotors[0]; 2];
    let weak_spin = [rotors[0], "gear='0 0 1 0 0 -0.0201'"];
    let from_hub = [rotors[0], "gear='0 0 1 0 0 -0.02' refsite='hub'"];
    for (found, property) in [
        (check(other_axis, rotors), "actuator gear"),
        (check(hips, same_spin), "actuator gear"),
        (check(hips, weak_spin), "actuator gear"),
        (check(hips, from_hub), "actuator reference site"),
    ] {
        assert_eq!(properties(&found), [property], "{}", found.text());
    }
}
