//! Generates the declarations from the installed `mujoco/mujoco.h` and links `libmujoco`.

use std::env;
use std::fs;
use std::panic;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::{Arc, Mutex, PoisonError};

/// Declarations for documentation that is built where MuJoCo is not installed, as on docs.rs.
const PREPARED: &str = include_str!("docs_rs.in");

/// The MuJoCo release that this workspace is written for, as `mj_version()` reports it.
const SUPPORTED_VERSION: u32 = 222;

/// Advice on a missing header or compiler library.
const REMEDY: &str = "Install MuJoCo 2.2.2 and libclang. On Debian 12:\n\n    \
     apt-get install libmujoco-dev libclang-dev\n\n\
     Elsewhere, unpack the archive of that release, point MUJOCO_DIR at its folder (which holds \
     include/ and lib/) and LIBCLANG_PATH at the folder of libclang.";

fn main() -> ExitCode {
    println!("cargo::rerun-if-changed=build.rs");
    println!("cargo::rerun-if-env-changed=DOCS_RS");
    println!("cargo::rerun-if-env-changed=MUJOCO_DIR");
    println!("cargo::rustc-link-lib=mujoco");
    match generate() {
        Ok(()) => ExitCode::SUCCESS,
        Err(reason) => {
            eprintln!("\ncovers-mujoco-sys: {reason}\n\n{REMEDY}\n");
            ExitCode::FAILURE
        }
    }
}

fn generate() -> Result<(), String> {
    let folder = env::var_os("OUT_DIR").ok_or("cargo set no OUT_DIR")?;
    let file = PathBuf::from(folder).join("bindings.rs");
    let unwritable = |error| format!("cannot write {}: {error}", file.display());
    if env::var_os("DOCS_RS").is_some() {
        println!("cargo::rustc-env=MUJOCO_HEADER_FOLDER=");
        return fs::write(&file, PREPARED).map_err(unwritable);
    }
    require_libclang()?;
    let installation = env::var_os("MUJOCO_DIR").map(PathBuf::from);
    if let Some(archive) = &installation {
        println!("cargo::rustc-link-search=native={}", library_folder(archive)?.display());
    }
    let headers = Headers::default();
    let bindings = declarations(&headers, installation.as_deref())?;
    require_version(&bindings.to_string())?;
    // what bindgen cannot read, the macro tables of mjxmacro.h, is found in the same folder
    println!("cargo::rustc-env=MUJOCO_HEADER_FOLDER={}", headers.folder()?);
    bindings.write_to_file(&file).map_err(unwritable)
}

/// Returns the folder of the library in an unpacked archive of MuJoCo, whose own file name ends with
/// the release.
fn library_folder(installation: &Path) -> Result<PathBuf, String> {
    let library = installation.join("lib/libmujoco.so");
    let file = library.canonicalize().map_err(|error| {
        format!(
            "MUJOCO_DIR is {}, where lib/libmujoco.so is missing: {error}",
            installation.display()
        )
    })?;
    let name = file.file_name().unwrap_or_default().to_string_lossy();
    if name != "libmujoco.so" && !name.ends_with(".2.2.2") {
        return Err(format!("{} is not of MuJoCo 2.2.2: got {name}", library.display()));
    }
    Ok(installation.join("lib"))
}

/// bindgen panics when it cannot load libclang; asking for its version first, with the panic
/// caught and its message muted, leaves ours as the only thing that the user reads.
fn require_libclang() -> Result<(), String> {
    let hook = panic::take_hook();
    panic::set_hook(Box::new(|_| ()));
    let loaded = panic::catch_unwind(bindgen::clang_version);
    panic::set_hook(hook);
    loaded.map(|_| ()).map_err(|_| {
        "libclang, which bindgen reads C headers with, cannot be loaded (package libclang-dev)."
            .into()
    })
}

/// Notes which headers clang reads, wherever it finds them.
#[derive(Clone, Debug, Default)]
struct Headers(Arc<Mutex<Vec<PathBuf>>>);

impl Headers {
    /// The folder of the `mujoco.h` that was read.
    fn folder(&self) -> Result<String, String> {
        let headers = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let mut headers = headers.iter();
        let header = headers.find(|path| path.ends_with("mujoco/mujoco.h"));
        let folder =
            header.and_then(|path| path.canonicalize().ok()?.parent()?.to_str().map(Into::into));
        folder.ok_or_else(|| "clang did not say where it found mujoco/mujoco.h".into())
    }
}

impl bindgen::callbacks::ParseCallbacks for Headers {
    fn include_file(&self, path: &str) {
        let mut headers = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        headers.push(Path::new(path).into());
    }
}

fn declarations(
    headers: &Headers,
    installation: Option<&Path>,
) -> Result<bindgen::Bindings, String> {
    let include = installation.map(|folder| format!("-I{}", folder.join("include").display()));
    bindgen::Builder::default()
        .clang_args(include)
        .header_contents("wrapper.h", "#include <mujoco/mujoco.h>\n")
        .allowlist_item("_?mj.*")
        .blocklist_item("_mjPRIVATE.*")
        .prepend_enum_name(false)
        .layout_tests(true)
        .parse_callbacks(Box::new(bindgen::CargoCallbacks::new()))
        .parse_callbacks(Box::new(headers.clone()))
        .generate()
        .map_err(|error| {
            format!("the header mujoco/mujoco.h (package libmujoco-dev) cannot be read:\n{error}")
        })
}

fn require_version(declarations: &str) -> Result<(), String> {
    let expected = format!("mjVERSION_HEADER: u32 = {SUPPORTED_VERSION};");
    if declarations.contains(&expected) {
        return Ok(());
    }
    let found = declarations.lines().find(|line| line.contains("mjVERSION_HEADER"));
    Err(format!(
        "mujoco/mujoco.h is not of MuJoCo 2.2.2: expected mjVERSION_HEADER {SUPPORTED_VERSION}, \
         got `{}`.",
        found.unwrap_or("no mjVERSION_HEADER")
    ))
}
