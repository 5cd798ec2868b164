//! MJCF files of `assets/mjcf`, compiled into the crate.

/// Name and text of an MJCF file; other files include it by the name.
pub(crate) type Mjcf<'a> = (&'a str, &'a str);

/// Expands to the name and text of one MJCF file of `assets/mjcf` or of a folder in it.
macro_rules! part {
    ($file:literal $(in $folder:literal)?) => {
        (
            $file,
            include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/assets/mjcf/", $($folder, "/",)? $file)),
        )
    };
}

/// Expands to the names and texts of several MJCF files of one folder.
macro_rules! parts {
    ([$($file:literal),+] in $folder:literal) => {
        [$(crate::mjcf::part!($file in $folder)),+]
    };
}

pub(crate) use {part, parts};
