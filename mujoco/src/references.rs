//! Names of files inside XML files.
//!
//! MuJoCo reads from the disk what it does not find among the files in memory. Relative names are
//! sent nowhere (see `vfs`), but a mesh or texture with an absolute path would be read.

use std::borrow::Cow;

use crate::error::ModelError;

/// Refuses absolute paths of files that are not given, and absolute folders.
pub(crate) fn check_references(files: &[(&str, &[u8])]) -> Result<(), ModelError> {
    let given = |name: &str| {
        files
            .iter()
            .any(|(file, _)| file.eq_ignore_ascii_case(name))
    };
    for (_, content) in files {
        let text = String::from_utf8_lossy(content);
        for (attribute, value) in attributes(&without_comments(&text)) {
            if is_absolute(value) && escapes(attribute, value, given) {
                return Err(ModelError::FileName {
                    name: value.into(),
                    reason: "it is an absolute path; files are found among those given, by their \
                             plain name",
                });
            }
        }
    }
    Ok(())
}

/// Whether an attribute makes MuJoCo look for a file at the path `value`.
fn escapes(attribute: &str, value: &str, given: impl Fn(&str) -> bool) -> bool {
    let plain = value.rsplit(['/', '\\']).next().unwrap_or(value);
    attribute.ends_with("dir") || (attribute.starts_with("file") && !given(plain))
}

/// A path from the root or a drive, or one that is written with character references.
fn is_absolute(value: &str) -> bool {
    value.starts_with(['/', '\\', '&']) || value.as_bytes().get(1) == Some(&b':')
}

fn without_comments(text: &str) -> Cow<'_, str> {
    if !text.contains("<!--") {
        return text.into();
    }
    let mut parts = text.split("<!--");
    let first = parts.next().unwrap_or_default();
    let rest = parts.filter_map(|part| Some(part.split_once("-->")?.1));
    std::iter::once(first).chain(rest).collect()
}

/// Names and values of the attributes of an XML text.
fn attributes(text: &str) -> impl Iterator<Item = (&str, &str)> {
    let mut rest = text;
    std::iter::from_fn(move || {
        loop {
            let (before, after) = rest.split_once('=')?;
            rest = after;
            let after = after.trim_start();
            let Some(quote) = after.chars().next().filter(|c| matches!(c, '"' | '\'')) else {
                continue;
            };
            let (value, after) = after[1..].split_once(quote)?;
            rest = after;
            let words = before.trim_end();
            let mut names = words.rsplit(|c: char| !(c.is_ascii_alphanumeric() || c == '_'));
            return Some((names.next()?, value.trim()));
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn check(main: &str) -> Result<(), ModelError> {
        check_references(&[("main.xml", main.as_bytes()), ("Ball.obj", b"v 0 0 0")])
    }

    #[test]
    fn attributes_are_found() {
        let text = "<a file = \"b.xml\"><c é='1=2' meshdir='/d'/> x=y <f filename=' /g '/>";
        let found: Vec<_> = attributes(text).collect();
        let expected = [
            ("file", "b.xml"),
            ("", "1=2"),
            ("meshdir", "/d"),
            ("filename", "/g"),
        ];
        assert_eq!(found, expected);
    }

    #[test]
    fn absolute_paths_are_refused_unless_the_file_is_given() {
        for refused in [
            "<mesh file='/tmp/cube.obj'/>",
            "<texture fileright=\"/tmp/sky.png\"/>",
            "<mesh file='&#47;tmp/cube.obj'/>",
            "<mesh file='C:\\cube.obj'/>",
            "<compiler meshdir=\"/tmp\"/>",
            "<!-- --> <mesh file='/tmp/cube.obj'/>",
        ] {
            let error = check(refused).unwrap_err();
            assert!(error.to_string().contains("absolute path"), "{error}");
        }
        for accepted in [
            "<mesh file='/tmp/ball.obj'/>",
            "<mesh file='cube.obj'/>",
            "<compiler meshdir='meshes'/>",
            "<!-- <mesh file='/tmp/cube.obj'/> -->",
            "<body name='/tmp'/>",
        ] {
            assert_eq!(check(accepted), Ok(()), "{accepted}");
        }
    }
}
