//! Writes the JavaScript module of a compiled program, which fits the version of `wasm-bindgen`
//! that it was compiled with: `cargo run --example bindings -- PROGRAM.wasm FOLDER`.

use std::error::Error;

use wasm_bindgen_cli_support::Bindgen;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [program, folder] = &arguments[..] else {
        return Err("expected the path of a compiled program and a folder".into());
    };
    Bindgen::new().input_path(program).web(true)?.typescript(false).generate(folder)?;
    Ok(())
}
