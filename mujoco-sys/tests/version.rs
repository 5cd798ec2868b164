//! The linked library is the release of the header. (Struct sizes and field offsets are checked
//! at compile time by bindgen's layout tests.)

#[test]
fn library_and_header_are_2_2_2() {
    // SAFETY: `mj_version` takes nothing and reads a constant.
    let library = unsafe { mujoco_sys::mj_version() };
    assert_eq!(library, 222);
    assert_eq!(mujoco_sys::mjVERSION_HEADER, 222);
}

#[test]
fn layout_tests_are_generated() {
    let declarations = include_str!(concat!(env!("OUT_DIR"), "/bindings.rs"));
    assert!(declarations.contains("Size of mjData_"));
    assert!(declarations.contains("Offset of field: mjModel_::nq"));
}

#[test]
fn documentation_without_mujoco_shows_the_same_declarations() {
    let generated = concat!(env!("OUT_DIR"), "/bindings.rs");
    let prepared = concat!(env!("CARGO_MANIFEST_DIR"), "/docs_rs.in");
    let [generated_text, prepared_text] =
        [generated, prepared].map(|path| std::fs::read_to_string(path).unwrap());
    assert!(generated_text == prepared_text, "copy {generated} to {prepared}");
}
