//! The linked library is the release of the header. (Struct sizes and field offsets are checked
//! at compile time by bindgen's layout tests.)

/// Release of Debian 12, with which published figures are made.
const REFERENCE: u32 = 222;

#[test]
fn library_and_header_are_of_one_release() {
    // SAFETY: `mj_version` takes nothing and reads a constant.
    let library = unsafe { mujoco_sys::mj_version() };
    assert_eq!(library, mujoco_sys::mjVERSION_HEADER.cast_signed());
    // another release is asked for by name
    assert!(library == REFERENCE.cast_signed() || option_env!("MUJOCO_DIR").is_some(), "{library}");
}

#[test]
fn layout_tests_are_generated() {
    let declarations = include_str!(concat!(env!("OUT_DIR"), "/bindings.rs"));
    assert!(declarations.contains("Size of mjData_"));
    assert!(declarations.contains("Offset of field: mjModel_::nq"));
}

#[test]
fn documentation_without_mujoco_shows_the_declarations_of_the_reference() {
    if mujoco_sys::mjVERSION_HEADER != REFERENCE {
        return;
    }
    let generated = concat!(env!("OUT_DIR"), "/bindings.rs");
    let prepared = concat!(env!("CARGO_MANIFEST_DIR"), "/docs_rs.in");
    let [generated_text, prepared_text] =
        [generated, prepared].map(|path| std::fs::read_to_string(path).unwrap());
    assert!(generated_text == prepared_text, "copy {generated} to {prepared}");
}
