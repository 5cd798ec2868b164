//! Saved states continue to the same bits.

#![allow(clippy::unwrap_used, reason = "test code")]

use std::sync::Arc;

use mujoco::{Data, Model, SimError, SimQuantity, State};

// a box that tumbles onto the floor while a weld drags it: contacts and an equality constraint
// keep the solver from converging to the last bit, so that the warm start matters
const TUMBLE: &str = r#"<mujoco>
  <size nuserdata="2"/>
  <option timestep="0.0025"/>
  <worldbody>
    <geom type="plane" size="5 5 1"/>
    <body name="target" mocap="true" pos="0 0 .5"/>
    <body name="box" pos="0 0 .4" euler="20 30 40"><freejoint/><geom type="box" size=".1 .07 .05"/>
      <body pos="0 0 .1"><joint name="hinge" axis="0 1 0"/><geom type="capsule" size=".02" fromto="0 0 0 .2 0 0"/></body>
    </body>
  </worldbody>
  <equality><weld body1="target" body2="box" solref="0.1 1"/></equality>
  <actuator><general joint="hinge" dyntype="filter" dynprm="0.1" gainprm=".1"/></actuator>
</mujoco>"#;

fn tumbling(model: &Arc<Model>) -> Data {
    let mut data = Data::new(model.clone());
    drive(&mut data, 0..100);
    data
}

/// Steps with a moving target and a changing control.
fn drive(data: &mut Data, steps: std::ops::Range<usize>) {
    let target = data.model().mocap_body("target").unwrap();
    for step in steps {
        let phase = step as f64 * 0.05;
        data.set_mocap_position(target, [0.2 * phase.sin(), 0.1 * phase.cos(), 0.05]).unwrap();
        data.set_all_ctrl(&[phase.cos()]).unwrap();
        data.step(1).unwrap();
    }
}

fn model() -> Arc<Model> {
    Arc::new(Model::from_xml(TUMBLE).unwrap())
}

#[test]
fn a_restored_run_continues_bit_for_bit() {
    let model = model();
    let mut original = tumbling(&model);
    let saved = original.save_state();
    assert!(original.contact_count() > 0, "contacts are what makes this hard");
    drive(&mut original, 100..300);

    // restored into fresh data, and into data in the middle of something else
    let mut busy = tumbling(&model);
    drive(&mut busy, 7..50);
    for mut restored in [Data::new(model.clone()), busy] {
        restored.restore_state(&saved).unwrap();
        assert_eq!(restored.save_state(), saved);
        drive(&mut restored, 100..300);
        assert_eq!(restored.save_state(), original.save_state());
    }
}

#[test]
fn without_the_warm_start_it_does_not() {
    let model = model();
    let mut original = tumbling(&model);
    let mut values = original.save_state().values().to_vec();
    // the layout ends with qacc_warmstart [nv] and ctrl [nu]
    let end = values.len() - model.nu();
    values[end - model.nv()..end].fill(0.0);
    let mut restored = Data::new(model.clone());
    restored.restore_state(&State::from(values)).unwrap();
    drive(&mut original, 100..300);
    drive(&mut restored, 100..300);
    assert_ne!(restored.qpos(), original.qpos());
}

#[test]
fn the_layout_is_the_documented_one() {
    let data = tumbling(&model());
    let state = data.save_state();
    let (nq, nv) = (data.model().nq(), data.model().nv());
    // time, qpos, qvel, act 1, mocap 3 + 4, userdata 2, warm start, ctrl 1
    assert_eq!(state.values().len(), 1 + nq + nv + 1 + 7 + 2 + nv + 1);
    assert_eq!(state.values()[0], data.time());
    assert_eq!(&state.values()[1..=nq], data.qpos());
    assert_eq!(&state.values()[1 + nq..][..nv], data.qvel());
    assert_eq!(state.values().last(), data.ctrl().last());
}

#[test]
fn foreign_states_are_refused() {
    let mut data = tumbling(&model());
    let before = data.save_state();
    let short = State::from(vec![0.0; 3]);
    let expected = before.values().len();
    assert_eq!(
        data.restore_state(&short),
        Err(SimError::WrongLength { what: SimQuantity::State, expected, got: 3 })
    );
    let mut values = before.values().to_vec();
    values[2] = f64::NAN;
    assert!(matches!(
        data.restore_state(&State::from(values)),
        Err(SimError::NotFinite { index: 2, .. })
    ));
    assert_eq!(data.save_state(), before, "a refused state changes nothing");
}

/// Forces that only the C struct can be given are not part of a state, and a restore clears them.
#[test]
fn restoring_clears_applied_forces() {
    let model = model();
    let mut original = tumbling(&model);
    let saved = original.save_state();
    let mut pushed = tumbling(&model);
    let raw = pushed.as_mut_ptr();
    // SAFETY: arrays of `nv` and of `nbody * 6` numbers that live as long as `pushed`.
    unsafe {
        *(*raw).qfrc_applied.add(2) = 30.0;
        *(*raw).xfrc_applied.add(6 * 2 + 1) = -40.0;
    }
    drive(&mut pushed, 100..200);
    pushed.restore_state(&saved).unwrap();
    drive(&mut original, 100..200);
    drive(&mut pushed, 100..200);
    assert_eq!(pushed.save_state(), original.save_state());
}
