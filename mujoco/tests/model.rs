//! Loading of models, and finding objects by name.

#![allow(clippy::unwrap_used, reason = "test code")]

use std::sync::Arc;

use mujoco::{Data, GeomShape, JointType, Model, ModelError};

const ARM: &str = r#"<mujoco>
  <option timestep="0.0025"/>
  <worldbody>
    <body name="target" mocap="true" pos="1 2 3"/>
    <body name="base"><joint name="lift" type="slide" axis="0 0 1" range="-1 2" limited="true"/>
      <geom name="block" type="box" size=".1 .2 .3" group="3" rgba=".25 .5 .75 1" contype="2" conaffinity="4"/>
      <body name="tip" pos="0 0 1"><joint name="turn"/><geom size=".1"/><site name="mark"/></body>
    </body>
    <camera name="top" pos="0 0 2"/>
  </worldbody>
  <actuator><motor name="drive" joint="lift" ctrllimited="true" ctrlrange="-3 4"/></actuator>
</mujoco>"#;

#[test]
fn sizes_and_readers() {
    let model = Model::from_xml(ARM).unwrap();
    assert_eq!((model.nq(), model.nv(), model.nu(), model.nmocap()), (2, 2, 1, 1));
    assert_eq!((model.nbody(), model.ngeom()), (4, 2));
    assert_eq!(model.timestep(), 0.0025);
    let (lift, turn) = (model.joint("lift").unwrap(), model.joint("turn").unwrap());
    assert_eq!((model.joint_qpos_address(turn), model.joint_dof_address(turn)), (1, 1));
    assert_eq!(model.joint_range(lift), Some([-1.0, 2.0]));
    assert_eq!(model.joint_range(turn), None);
    let block = model.geom("block").unwrap();
    assert_eq!(model.geom_group(block), 3);
    assert_eq!(model.geom_rgba(block), [0.25, 0.5, 0.75, 1.0]);
    assert_eq!(model.geom_size(block), [0.1, 0.2, 0.3]);
    assert_eq!(model.geom_collision_masks(block), (2, 4));
    let base = model.body("base").unwrap();
    assert_eq!(model.geom_body(block), base);
    assert_eq!(model.name_of(base), Some("base"));
    assert_eq!(model.compile_warning(), None);
}

#[test]
fn what_has_no_name_is_listed() {
    let model = Model::from_xml(ARM).unwrap();
    assert_eq!(model.unnamed_objects(), ["geom 1"]);
}

#[test]
fn ids_are_indices() {
    let model = Model::from_xml(ARM).unwrap();
    assert_eq!(model.body("world").unwrap().index(), 0);
    assert_eq!(model.body("tip").unwrap().index(), 3);
    assert_eq!(model.mocap_body("target").unwrap().index(), 0);
    assert_eq!(model.site("mark").unwrap().index(), 0);
    assert_eq!(model.camera("top").unwrap().index(), 0);
    assert_eq!(format!("{:?}", model.body("tip").unwrap()), "body 3");
}

#[test]
fn an_unknown_name_lists_the_known_ones() {
    let model = Model::from_xml(ARM).unwrap();
    let error = model.body("tpi").unwrap_err();
    assert_eq!(
        error.to_string(),
        "the model has no body named `tpi`; known: world, target, base, tip"
    );
    // the second geom has no name: it is neither listed nor found
    let geom_error = model.geom("").unwrap_err();
    assert_eq!(geom_error.to_string(), "the model has no geom named ``; known: block");
    assert!(model.joint("li\0ft").is_err());
    let mocap_error = model.mocap_body("tip").unwrap_err();
    assert_eq!(
        mocap_error,
        ModelError::NotMocapBody { name: "tip".into(), known: vec!["target".into()] }
    );
}

#[test]
fn includes_are_found_among_the_files() {
    let main = br#"<mujoco><include file="part.xml"/></mujoco>"#;
    let part = br#"<mujoco><worldbody><body name="included"/></worldbody></mujoco>"#;
    let model = Model::from_files("main.xml", &[("part.xml", part), ("main.xml", main)]).unwrap();
    assert!(model.body("included").is_ok());

    let error = Model::from_files("main.xml", &[("main.xml", main)]).unwrap_err();
    assert!(error.to_string().contains("part.xml"), "{error}");
}

/// A given file must be found whatever the folder and the case of the name, and no other must be
/// looked for on the disk.
#[test]
fn absolute_folders_do_no_harm_where_every_file_is_given() {
    let main = br#"<mujoco><compiler meshdir="/no/such/folder"/>
        <asset><mesh name="a" file="ball.obj"/><mesh name="b" file="/nor/this/BALL.obj"/></asset>
        <worldbody><geom type="mesh" mesh="a"/><geom type="mesh" mesh="b"/></worldbody></mujoco>"#;
    let obj = b"# made by file='/elsewhere/ball.blend'
v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n";
    let model = Model::from_files("main.xml", &[("main.xml", main), ("Ball.obj", obj)]);
    if let Err(error) = &model {
        let release = mujoco::library_version();
        assert!(release.starts_with("3.2.") || release.starts_with("3.3."), "{release}: {error}");
        assert!(error.to_string().contains("ball.obj"), "it looks in the folder: {error}");
        return;
    }
    assert_eq!(model.unwrap().as_raw().nmesh, 2);
    let error = Model::from_files("main.xml", &[("main.xml", main)]).unwrap_err();
    assert!(error.to_string().contains("BALL.obj"), "{error}");
}

#[test]
fn bad_xml_carries_mujocos_message() {
    let error = Model::from_xml("<mujoco><worldbody><bdy/></worldbody></mujoco>").unwrap_err();
    let ModelError::LoadFailed { file, message } = &error else {
        panic!("{error}");
    };
    assert_eq!(file, "model.xml");
    assert!(message.contains("bdy") && message.contains("line"), "{message}");
}

#[test]
fn errors_of_the_compiler_and_the_engine_are_values() {
    let negative =
        r#"<mujoco><worldbody><body><joint/><geom size="-1"/></body></worldbody></mujoco>"#;
    let error = Model::from_xml(negative).unwrap_err();
    assert!(error.to_string().contains("size"), "{error}");
    let truncated = Model::from_xml("<mujoco><worldbody>").unwrap_err();
    assert!(matches!(truncated, ModelError::LoadFailed { .. }));
}

#[test]
fn the_main_file_must_be_given() {
    let error = Model::from_files("main.xml", &[("part.xml", b"<mujoco/>")]).unwrap_err();
    assert_eq!(error.to_string(), "main file `main.xml` is not among the files given: part.xml");
}

#[test]
fn models_load_on_several_threads_at_once() {
    std::thread::scope(|scope| {
        for thread in 0..4 {
            scope.spawn(move || {
                let xml =
                    format!(r#"<mujoco><worldbody><body name="b{thread}"/></worldbody></mujoco>"#);
                for _ in 0..20 {
                    assert!(Model::from_xml(&xml).unwrap().body(&format!("b{thread}")).is_ok());
                    assert!(Model::from_xml("<mujoco><no/></mujoco>").is_err());
                }
            });
        }
    });
}

#[test]
fn geoms_have_shapes_and_axes() {
    let model = Model::from_xml(
        r#"<mujoco><worldbody>
             <geom type="plane" size="1 1 1"/>
             <geom type="sphere" size=".1"/>
             <geom type="capsule" size=".1 .2" euler="0 90 0"/>
             <geom type="cylinder" size=".1 .3"/>
             <geom type="box" size=".1 .2 .3"/>
             <geom type="ellipsoid" size=".1 .2 .3"/>
           </worldbody></mujoco>"#,
    )
    .unwrap();
    let (radius, half) = (0.1, [0.1, 0.2, 0.3]);
    let shapes: Vec<_> = model.geoms().map(|geom| model.geom_shape(geom)).collect();
    let expected = [
        None,
        Some(GeomShape::Sphere { radius }),
        Some(GeomShape::Capsule { radius, half_length: 0.2 }),
        Some(GeomShape::Cylinder { radius, half_length: 0.3 }),
        Some(GeomShape::Box { half }),
        None,
    ];
    assert_eq!(shapes, expected);

    let capsule = model.geoms().nth(2).unwrap();
    let mut data = Data::new(model.into());
    data.forward().unwrap();
    let [x, y, z] = data.geom_axes(capsule);
    for (axis, direction) in [(x, [0.0, 0.0, -1.0]), (y, [0.0, 1.0, 0.0]), (z, [1.0, 0.0, 0.0])] {
        let off = axis.iter().zip(direction).map(|(a, b)| (a - b).abs());
        assert!(off.sum::<f64>() < 1e-12, "{axis:?} is not {direction:?}");
    }
}

/// A gate with a sliding bolt, a loose ball, and a post that is not mirrored.
const GATE: &str = r#"<mujoco>
  <compiler angle="radian"/>
  <worldbody>
    <geom name="post" type="box" size=".01 .02 .03" pos=".3 .1 0"/>
    <body name="frame" pos=".2 .3 .4" euler=".1 .2 .3">
      <geom name="wall" type="box" size=".1 .01 .2" pos=".05 0 .02" euler="0 .2 .4"/>
      <body name="gate" pos="-.1 .02 0"><joint name="hinge" axis=".1 .2 1" pos=".01 0 0"/>
        <geom name="leaf" type="box" size=".1 .01 .2" pos=".1 .01 0" euler=".1 0 .2"/>
        <site name="handle" pos=".19 -.03 .05"/>
        <body name="bolt" pos=".15 0 0"><joint name="slide" type="slide" axis="1 .1 .2"/>
          <geom name="rod" type="capsule" size=".01 .05" euler="0 1.2 0"/></body>
      </body>
    </body>
    <body name="ball" pos=".5 .6 .7" euler=".3 .2 .1"><freejoint name="loose"/>
      <geom name="ball" type="ellipsoid" size=".1 .05 .02" pos=".01 .02 .03"/></body>
  </worldbody>
</mujoco>"#;

#[test]
fn a_reflected_model_moves_as_the_mirror_image() {
    let model = Model::from_xml(GATE).unwrap();
    let roots = ["frame", "ball"].map(|name| model.body(name).unwrap());
    let mirrored = model.with_mirrored_bodies(&roots).unwrap();
    assert_eq!(mirrored.name_of(roots[1]), Some("ball"));
    let mut tables = [model, mirrored].map(|model| Data::new(Arc::new(model)));
    for (data, side) in tables.iter_mut().zip([1.0, -1.0]) {
        // velocities of hinge, slide, and of the ball, whose rotation is in its own frame
        data.qvel_mut().copy_from_slice(&[
            2.0,
            0.5,
            side * 0.3,
            0.2,
            0.1,
            0.7,
            side * 0.4,
            side * 0.9,
        ]);
        data.step(100).unwrap();
        data.forward().unwrap();
    }
    let [here, there] = &tables;
    let ids = here.model();
    // 2.2.2 rounds both sides alike, later releases do not
    let tolerance = if cfg!(mujoco3) { 1e-12 } else { 0.0 };
    let equal = |a: &[f64], b: &[f64]| a.iter().zip(b).all(|(a, b)| (a - b).abs() <= tolerance);
    assert!(equal(&here.qpos()[..2], &there.qpos()[..2]));
    assert!(here.qpos()[0] > 0.1, "the gate turns");
    let twins = |a: [f64; 3], b: [f64; 3]| {
        assert!((a[0] + b[0]).abs() < 1e-15 + tolerance && equal(&a[1..], &b[1..]), "{a:?} {b:?}");
    };
    for name in ["wall", "leaf", "rod", "ball"] {
        let geom = ids.geom(name).unwrap();
        twins(here.geom_position(geom), there.geom_position(geom));
        let [axes, other] = [here, there].map(|data| data.geom_axes(geom));
        for (axis, (a, b)) in axes.into_iter().zip(other).enumerate() {
            let side = if axis == 0 { -1.0 } else { 1.0 };
            let flipped = b.map(|value| side * value);
            assert!((a[0] + flipped[0]).abs() < 1e-15 + tolerance, "{name} {axis}: {a:?} {b:?}");
            assert!(equal(&a[1..], &flipped[1..]), "{name} {axis}");
        }
    }
    let handle = ids.site("handle").unwrap();
    twins(here.site_position(handle), there.site_position(handle));
    let post = ids.geom("post").unwrap();
    assert_eq!(here.geom_position(post), there.geom_position(post));
}

#[test]
fn a_translated_model_moves_elsewhere_alike() {
    let model = Model::from_xml(GATE).unwrap();
    let offset = [0.5, -0.25, 1.0];
    let moved = model.translated(offset).unwrap();
    let mut tables = [model, moved].map(|model| Data::new(Arc::new(model)));
    for data in &mut tables {
        data.qvel_mut()[0] = 2.0;
        data.step(100).unwrap();
        data.forward().unwrap();
    }
    let [here, there] = &tables;
    for name in ["post", "wall", "leaf", "rod", "ball"] {
        let geom = here.model().geom(name).unwrap();
        let (a, b) = (here.geom_position(geom), there.geom_position(geom));
        let off = (0..3).map(|i| (b[i] - a[i] - offset[i]).abs());
        assert!(off.fold(0.0, f64::max) < 1e-14, "{name}: {a:?} {b:?}");
    }
}

#[test]
fn a_geom_at_the_origin_of_the_world_is_translated_too() {
    let model = Model::from_xml(
        r#"<mujoco><worldbody>
             <geom name="ball" size=".1"/><site name="mark"/>
           </worldbody></mujoco>"#,
    );
    let moved = Arc::new(model.unwrap().translated([1.0, 2.0, 3.0]).unwrap());
    let mut data = Data::new(Arc::clone(&moved));
    data.forward().unwrap();
    assert_eq!(data.geom_position(moved.geom("ball").unwrap()), [1.0, 2.0, 3.0]);
    assert_eq!(data.site_position(moved.site("mark").unwrap()), [1.0, 2.0, 3.0]);
}

#[test]
fn joints_tell_their_types() {
    let model = Model::from_xml(
        r#"<mujoco><worldbody>
             <body><freejoint name="free"/><geom size=".1"/>
               <body><joint name="ball" type="ball"/><geom size=".1"/></body>
               <body><joint name="slide" type="slide"/><geom size=".1"/></body>
               <body><joint name="hinge"/><geom size=".1"/></body></body>
           </worldbody></mujoco>"#,
    )
    .unwrap();
    let types =
        ["free", "ball", "slide", "hinge"].map(|name| model.joint_type(model.joint(name).unwrap()));
    let expected = [JointType::Free, JointType::Ball, JointType::Slide, JointType::Hinge];
    assert_eq!(types, expected);
}

/// A world with a `body` beside it, which holds `inside`.
fn with_body(inside: &str, outside: &str) -> Model {
    Model::from_xml(&format!(
        r#"<mujoco><option><flag contact="disable"/></option>{outside}
             <asset><hfield name="hills" nrow="2" ncol="2" size="1 1 .1 .1"/>
               <mesh name="wedge" vertex="0 0 0  .5 0 0  0 .3 0  .1 .1 .4"/></asset>
             <worldbody><geom name="floor" type="plane" size="1 1 1"/>
               <body name="other"><geom size=".1"/></body>
               <body name="body"><geom size=".1"/>{inside}</body>
             </worldbody></mujoco>"#
    ))
    .unwrap()
}

#[test]
fn poses_that_a_copy_would_keep_are_refused() {
    let weld = |other| format!("<equality><weld body1=\"body\" {other}/></equality>");
    let [to_world, to_other] = ["", "body2=\"other\""].map(weld);
    let key = "<keyframe><key/></keyframe>";
    let reflected = |inside, outside| {
        let model = with_body(inside, outside);
        model.with_mirrored_bodies(&[model.body("body").unwrap()]).unwrap_err().to_string()
    };
    for (inside, outside, says) in [
        ("<body><joint type=\"ball\"/><geom size=\".1\"/></body>", "", "a ball joint"),
        ("<geom type=\"mesh\" mesh=\"wedge\"/>", "", "a mesh"),
        ("<geom type=\"hfield\" hfield=\"hills\"/>", "", "a height field"),
        ("<camera/>", "", "a camera"),
        ("<light/>", "", "a light"),
        ("", &to_other, "a weld or connect constraint"),
        ("", key, "a keyframe"),
    ] {
        let message = reflected(inside, outside);
        assert!(message.contains("cannot be mirrored") && message.contains(says), "{message}");
    }
    for (outside, says) in
        [(to_world.as_str(), "a weld or connect constraint"), (key, "a keyframe")]
    {
        let message = with_body("", outside).translated([1.0; 3]).unwrap_err().to_string();
        assert!(message.contains("cannot be moved") && message.contains(says), "{message}");
    }
    let fine = with_body("", &to_other);
    fine.translated([1.0; 3]).unwrap();
    fine.with_mirrored_bodies(&[]).unwrap();
}
