//! The files that scenes are made of: `assets/mjcf`, compiled in.

/// A file's name, by which others include it, and its text.
pub(crate) type Mjcf<'a> = (&'a str, &'a str);

/// A file of `assets/mjcf`, or of one of its folders.
macro_rules! part {
    ($file:literal $(in $folder:literal)?) => {
        (
            $file,
            include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/assets/mjcf/", $($folder, "/",)? $file)),
        )
    };
}

/// Files of one folder.
macro_rules! parts {
    ([$($file:literal),+] in $folder:literal) => {
        [$(crate::mjcf::part!($file in $folder)),+]
    };
}

pub(crate) use {part, parts};
