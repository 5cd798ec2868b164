//! Generates the declarations from the installed `mujoco/mujoco.h` and links `libmujoco`.

use std::env;
use std::fs;
use std::os::unix::fs::symlink;
use std::panic;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::{Arc, Mutex, PoisonError};

use version::release_name;

#[path = "src/version.rs"]
mod version;

/// Declarations for documentation that is built where MuJoCo is not installed, as on docs.rs.
const PREPARED: &str = include_str!("docs_rs.in");

/// Release of Debian 12, with which published figures are made, as `mj_version()` reports it.
const REFERENCE_VERSION: i32 = 222;

/// Advice on a missing header or compiler library.
const REMEDY: &str = "Install MuJoCo 2.2.2 and libclang. On Debian 12:\n\n    \
     apt-get install libmujoco-dev libclang-dev\n\n\
     Elsewhere, or for MuJoCo 3, unpack the archive of a release, or its Python wheel, point \
     MUJOCO_DIR at the folder that holds include/, and LIBCLANG_PATH at the folder of libclang.";

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
    let folder = PathBuf::from(env::var_os("OUT_DIR").ok_or("cargo set no OUT_DIR")?);
    let file = folder.join("bindings.rs");
    let unwritable = |error| format!("cannot write {}: {error}", file.display());
    if env::var_os("DOCS_RS").is_some() {
        println!("cargo::rustc-env=MUJOCO_HEADER_FOLDER=");
        return fs::write(&file, PREPARED).map_err(unwritable);
    }
    require_libclang()?;
    let installation = env::var_os("MUJOCO_DIR").map(PathBuf::from);
    let headers = Headers::default();
    let bindings = declarations(&headers, installation.as_deref())?;
    let declared = bindings.to_string();
    let version = header_version(&declared)?;
    println!("cargo::metadata=MAJOR={}", if version == REFERENCE_VERSION { 2 } else { 3 });
    // recent releases count actuators, their controls and their outputs on their own
    println!("cargo::metadata=ACTUATOR_COUNTS={}", declared.contains("pub nactuator:"));
    if let Some(installation) = &installation {
        link_library(installation, version, &folder)?;
    }
    // what bindgen cannot read, the macro tables of mjxmacro.h, is found in the same folder
    println!("cargo::rustc-env=MUJOCO_HEADER_FOLDER={}", headers.folder()?);
    bindings.write_to_file(&file).map_err(unwritable)
}

/// Links the library of an installation whose headers are of the release `version`: an unpacked
/// archive, or the folder `mujoco` of a Python wheel, which has no link `libmujoco.so`. That is
/// made in `out`.
fn link_library(installation: &Path, version: i32, out: &Path) -> Result<(), String> {
    let expected = format!("libmujoco.so.{}", release_name(version));
    let folders = [installation.join("lib"), installation.to_path_buf()];
    let names = [&expected, "libmujoco.so"];
    let mut paths = names.iter().flat_map(|name| folders.iter().map(move |in_it| in_it.join(name)));
    let library = paths.find_map(|path| path.canonicalize().ok()).ok_or_else(|| {
        format!(
            "MUJOCO_DIR is {0}, but {0} and {0}/lib hold no {expected} or libmujoco.so",
            installation.display()
        )
    })?;
    let name = library.file_name().unwrap_or_default().to_string_lossy();
    if name != "libmujoco.so" && name != expected {
        return Err(format!(
            "{} does not belong to its headers: expected {expected}",
            library.display()
        ));
    }
    let link = out.join("libmujoco.so");
    let _ = fs::remove_file(&link);
    symlink(&library, &link)
        .map_err(|error| format!("cannot write {}: {error}", link.display()))?;
    println!("cargo::rustc-link-search=native={}", out.display());
    Ok(())
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

/// Returns the release of the headers, if it is one that the workspace supports.
fn header_version(declarations: &str) -> Result<i32, String> {
    let (_, after) = declarations
        .split_once("mjVERSION_HEADER: u32 = ")
        .ok_or("mujoco/mujoco.h has no mjVERSION_HEADER")?;
    let digits: String = after.chars().take_while(char::is_ascii_digit).collect();
    let version =
        digits.parse().map_err(|error| format!("mjVERSION_HEADER is {digits}: {error}"))?;
    // 3.2 counts as 320, 3.17 as 3017000
    let is_release_3 = (320..400).contains(&version) || (3_000_000..4_000_000).contains(&version);
    if version == REFERENCE_VERSION || is_release_3 {
        return Ok(version);
    }
    Err(format!(
        "mujoco/mujoco.h is of MuJoCo {}, expected 2.2.2, or 3.2 or later (below 4).",
        release_name(version)
    ))
}
