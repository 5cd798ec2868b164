//! Steps, and errors in the cases in which MuJoCo would fail silently.

#![allow(clippy::unwrap_used, reason = "test code")]

use std::path::Path;
use std::sync::Arc;

use mujoco::{Data, Model, SimError, SimQuantity};

const CART: &str = r#"<mujoco>
  <option timestep="0.002" gravity="0 0 0"/>
  <worldbody>
    <body name="target" mocap="true" pos="1 2 3"/>
    <body name="cart"><joint name="x" type="slide" axis="1 0 0"/><geom name="hull" size=".1" mass="1"/>
      <site name="tip" pos=".1 0 0"/></body>
  </worldbody>
  <actuator><motor joint="x"/></actuator>
</mujoco>"#;

fn data(xml: &str) -> Data {
    Data::new(Arc::new(Model::from_xml(xml).unwrap()))
}

#[test]
fn a_constant_force_accelerates() {
    let mut data = data(CART);
    data.set_all_ctrl(&[2.0]).unwrap();
    data.step(10).unwrap();
    assert!((data.time() - 0.02).abs() < 1e-12);
    assert!((data.qvel()[0] - 2.0 * 0.02).abs() < 1e-12);
    data.reset();
    assert_eq!((data.time(), data.qvel()[0], data.ctrl()[0]), (0.0, 0.0, 0.0));
}

#[test]
fn divergence_is_an_error_and_its_counters_are_cleared() {
    let mut data = data(CART);
    data.step(3).unwrap();
    data.qvel_mut()[0] = 1e11;
    let error = data.step(5).unwrap_err();
    let SimError::Diverged { what: SimQuantity::Qvel, index: 0, time } = error else {
        panic!("{error}");
    };
    assert!((time - 0.006).abs() < 1e-12);
    assert_eq!((data.time(), data.qvel()[0]), (0.0, 0.0), "the state is the initial one");
    data.step(5).unwrap();
}

#[test]
fn every_bad_quantity_is_noticed() {
    for expected in [SimQuantity::Qpos, SimQuantity::Qvel] {
        let mut data = data(CART);
        match expected {
            SimQuantity::Qpos => data.qpos_mut()[0] = f64::NAN,
            _ => data.qvel_mut()[0] = f64::INFINITY,
        }
        assert!(
            matches!(data.forward(), Err(SimError::NotFinite { what, .. }) if what == expected)
        );
        assert!(matches!(data.step(1), Err(SimError::Diverged { what, .. }) if what == expected));
        assert_eq!(data.step(1), Ok(()));
    }
}

/// Finite positions whose squares overflow: MuJoCo computes accelerations that are NaN.
#[test]
fn forward_tells_of_accelerations_that_are_not_finite() {
    let joints = r#"<joint type="slide"/><joint type="hinge" axis="0 1 0"/>
        <geom size=".1" pos="1 0 0"/>"#;
    let mut data = data(&format!(
        "<mujoco><worldbody><body>{joints}<body>{joints}</body></body></worldbody></mujoco>"
    ));
    assert_eq!(data.forward(), Ok(()));
    data.qpos_mut().fill(1e300);
    let error = data.forward().unwrap_err();
    assert!(
        matches!(error, SimError::NotFinite { what: SimQuantity::Qacc, index: 0, value } if value.is_nan()),
        "{error}"
    );
    let step = data.step(1).unwrap_err();
    assert!(matches!(step, SimError::Diverged { what: SimQuantity::Qpos, .. }), "{step}");
    assert_eq!(data.forward(), Ok(()));
}

#[test]
fn huge_controls_and_forces_diverge() {
    let strong = CART.replace("<motor ", r#"<motor gear="1000" "#);
    for (control, expected) in [(1e300, SimQuantity::Ctrl), (9e9, SimQuantity::Qacc)] {
        let mut data = data(&strong);
        data.set_all_ctrl(&[control]).unwrap();
        assert!(matches!(data.step(1), Err(SimError::Diverged { what, .. }) if what == expected));
    }
}

#[test]
fn controls_that_are_not_finite_are_refused() {
    let mut data = data(CART);
    data.set_all_ctrl(&[0.5]).unwrap();
    for value in [f64::NAN, f64::INFINITY] {
        let error = data.set_all_ctrl(&[value]).unwrap_err();
        assert_eq!(error.to_string(), format!("ctrl[0] is {value}, which is not finite"));
    }
    let error = data.set_all_ctrl(&[0.0, 1.0]).unwrap_err();
    assert_eq!(error, SimError::WrongLength { what: SimQuantity::Ctrl, expected: 1, got: 2 });
    assert_eq!(data.ctrl(), [0.5], "a refused control changes nothing");
}

#[test]
fn derived_quantities_lag_until_forward() {
    let mut data = data(CART);
    let cart = data.model().body("cart").unwrap();
    let tip = data.model().site("tip").unwrap();
    let hull = data.model().geom("hull").unwrap();
    data.forward().unwrap();
    data.qvel_mut()[0] = 1.0;
    data.step(1).unwrap();
    assert_eq!(data.qpos()[0], 0.002);
    assert_eq!(data.body_position(cart)[0], 0.0, "one step behind");
    data.forward().unwrap();
    assert_eq!(data.body_position(cart)[0], 0.002);
    assert_eq!(data.geom_position(hull)[0], 0.002);
    assert_eq!(data.site_position(tip)[0], 0.1 + 0.002);
    assert_eq!(data.body_orientation(cart), [1.0, 0.0, 0.0, 0.0]);
}

#[test]
fn mocap_bodies_are_moved() {
    let mut data = data(CART);
    let mocap = data.model().mocap_body("target").unwrap();
    let body = data.model().body("target").unwrap();
    assert_eq!(data.mocap_position(mocap), [1.0, 2.0, 3.0]);
    data.set_mocap_position(mocap, [4.0, 5.0, 6.0]).unwrap();
    data.set_mocap_orientation(mocap, [0.0, 2.0, 0.0, 0.0]).unwrap();
    data.forward().unwrap();
    assert_eq!(data.body_position(body), [4.0, 5.0, 6.0]);
    assert_eq!(data.body_orientation(body), [0.0, 1.0, 0.0, 0.0]);
    assert!(data.set_mocap_position(mocap, [0.0, f64::NAN, 0.0]).is_err());
    for value in [[0.0; 4], [1e-7, 0.0, 0.0, 0.0], [0.0, 0.0, 1e200, 1.0]] {
        let refused = data.set_mocap_orientation(mocap, value);
        assert_eq!(refused, Err(SimError::NotNormalisable { value }));
    }
    assert_eq!(data.mocap_orientation(mocap), [0.0, 1.0, 0.0, 0.0], "normalised");
}

const BALLS: &str = r#"<mujoco>SIZE<worldbody>
    <geom name="floor" type="plane" size="1 1 1"/>
    <body pos="0 0 .09"><freejoint/><geom name="left" size=".1"/></body>
    <body pos=".5 0 .09"><freejoint/><geom name="right" size=".1"/></body>
  </worldbody></mujoco>"#;

#[test]
fn contacts_name_their_geoms() {
    let mut data = data(&BALLS.replace("SIZE", ""));
    assert_eq!(data.contact_count(), 0);
    data.forward().unwrap();
    assert_eq!(data.contact_count(), 2);
    let floor = data.model().geom("floor").unwrap();
    let right = data.model().geom("right").unwrap();
    let touching = data.contacts().find(|contact| contact.geoms.contains(&right)).unwrap();
    assert_eq!(touching.geoms, [floor, right]);
    assert!((touching.distance + 0.01).abs() < 1e-12);
    assert!((touching.position[0] - 0.5).abs() < 1e-12);
}

#[test]
fn dropped_contacts_are_an_error() {
    // memory for the collisions of many balls, but not for their contacts
    let (name, value, expected) =
        if cfg!(mujoco3) { ("memory", "116K", 116 << 10) } else { ("nconmax", "1", 1) };
    let ball = r#"<body pos="2 0 .09"><freejoint/><geom size=".1"/></body></worldbody>"#;
    let scene = (0..40).fold(BALLS.to_owned(), |xml, _| xml.replace("</worldbody>", ball));
    let mut data = data(&scene.replace("SIZE", &format!(r#"<size {name}="{value}"/>"#)));
    let error = data.step(1).unwrap_err();
    assert!(
        matches!(error, SimError::BufferOverflow { what: "contacts", limit, .. } if limit == expected),
        "{error}"
    );
    assert!(error.to_string().contains(name), "{error}");
}

#[test]
fn warnings_leave_no_log_file() {
    let mut data = data(CART);
    data.qpos_mut()[0] = f64::NAN;
    assert!(data.step(1).is_err());
    assert!(!Path::new("MUJOCO_LOG.TXT").exists());
}

#[test]
fn data_moves_to_another_thread() {
    let mut data = data(CART);
    let moved = std::thread::spawn(move || data.step(3).map(|()| data.time()));
    assert!(moved.join().unwrap().is_ok_and(|time| time > 0.0));
}

#[test]
fn what_the_wrapper_lacks_is_within_reach_of_the_c_library() {
    let mut data = data(&CART.replace("0 0 0", "0 0 -10"));
    data.forward().unwrap();
    let model = Arc::clone(data.model());
    assert_eq!(model.as_raw().nv, 1);
    let mut jacobian = [0.0; 3];
    let cart = model.body("cart").unwrap().index() as i32;
    // SAFETY: model and data go together; the output holds 3 x nv numbers, NULL asks for none.
    unsafe {
        let (model, data) = (model.as_raw(), data.as_mut_ptr());
        mujoco::raw::mj_jacBody(model, data, jacobian.as_mut_ptr(), std::ptr::null_mut(), cart);
        mujoco::raw::mj_energyPos(model, data);
    }
    assert_eq!(jacobian, [1.0, 0.0, 0.0]);
    assert_eq!(data.as_raw().energy[0], 0.0, "the cart is at height 0");
}
