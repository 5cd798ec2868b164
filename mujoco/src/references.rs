//! Checks of the file names inside a model's XML files.
//!
//! MuJoCo reads files from the disk if it does not find them among the files in memory. Relative
//! names lead nowhere (see `vfs`). An absolute path, or a relative one in an absolute folder, would
//! be read.

use std::collections::VecDeque;

use quick_xml::Reader;
use quick_xml::events::{BytesStart, Event};

use crate::error::ModelError;

/// Rejects references that would make MuJoCo look for a file outside of `files`: an absolute path,
/// or an absolute folder, of a file that is not given.
///
/// Only `main` and the files that it includes or names as models are checked, as these are all that
/// MuJoCo reads as XML.
pub(crate) fn reject_outside_references(
    main: &str,
    files: &[(&str, &[u8])],
) -> Result<(), ModelError> {
    let references = References::of(main, files)?;
    let is_missing = |file: &&String| !files.iter().any(|(given, _)| is_named(given, file));
    let missing: Vec<_> = references.files.iter().filter(is_missing).collect();
    let mut values = references.folders.iter().chain(&references.files);
    let outside = references.folders.iter().any(|folder| is_absolute(folder));
    let mut nameless =
        references.files.iter().filter(|file| !file.is_empty() && plain(file).is_empty());
    let mut absolute = missing.iter().copied().filter(|file| is_absolute(file));
    let refused = [
        (values.find(|value| value.contains('&')), ENTITY),
        (nameless.next(), NAMELESS),
        (absolute.next(), ABSOLUTE),
        (missing.first().copied().filter(|_| outside), OUTSIDE),
    ];
    for (name, reason) in refused {
        if let Some(name) = name.cloned() {
            return Err(ModelError::InvalidFileName { name, reason });
        }
    }
    Ok(())
}

const ENTITY: &str = "it holds a character reference; write the character itself";
// MuJoCo would end the process
const NAMELESS: &str = "nothing follows its last slash; name a file";
const ABSOLUTE: &str =
    "it is an absolute path; files are found among those given, by their plain name";
const OUTSIDE: &str =
    "it is not among the files given, and would be looked up in an absolute path; give the file";

/// File names that the XML of a model refers to.
#[derive(Default)]
struct References {
    folders: Vec<String>,
    files: Vec<String>,
}

impl References {
    /// Collects the file references of `main` and of every given file that it includes, at any
    /// depth.
    ///
    /// A syntax error or a document type is rejected, because MuJoCo's own reader may read elements
    /// there.
    fn of(main: &str, files: &[(&str, &[u8])]) -> Result<Self, ModelError> {
        let (mut found, mut read) = (Self::default(), vec![false; files.len()]);
        let mut included = VecDeque::from([main.to_owned()]);
        while let Some(name) = included.pop_front() {
            for ((given, content), is_read) in files.iter().zip(&mut read) {
                if is_named(given, &name) && !std::mem::replace(is_read, true) {
                    let names = found.add(content).map_err(|message| ModelError::LoadFailed {
                        file: (*given).to_owned(),
                        message,
                    })?;
                    included.extend(names);
                }
            }
        }
        Ok(found)
    }

    /// Adds the file references in the XML `content`; returns the names of the files that it
    /// includes.
    fn add(&mut self, content: &[u8]) -> Result<Vec<String>, String> {
        // MuJoCo's reader treats some of them as white space, ours as parts of names
        let is_control = |byte: &u8| *byte < b' ' && !b"\t\n\r".contains(byte);
        if let Some(at) = content.iter().position(is_control) {
            let line = content[..at].iter().filter(|&&byte| byte == b'\n').count() + 1;
            let byte = content[at];
            return Err(format!("XML, line {line}: the control character {byte:#04x}"));
        }
        let mut reader = Reader::from_reader(content);
        // wrong end tags are left to MuJoCo; references behind them must be checked nevertheless
        reader.config_mut().check_end_names = false;
        reader.config_mut().allow_unmatched_ends = true;
        let mut included = Vec::new();
        loop {
            let wrong = match reader.read_event() {
                Ok(Event::Start(element) | Event::Empty(element)) => {
                    let taken = self.take(&element).map(|file| included.extend(file));
                    taken.err().map(|error| error.to_string())
                }
                Ok(Event::DocType(_)) => Some("it has a document type; leave it out".to_owned()),
                Ok(Event::Eof) => return Ok(included),
                Ok(_) => None,
                Err(error) => Some(error.to_string()),
            };
            if let Some(wrong) = wrong {
                let read = &content[..reader.buffer_position() as usize];
                let line = read.iter().filter(|&&byte| byte == b'\n').count() + 1;
                return Err(format!("XML, line {line}: {wrong}"));
            }
        }
    }

    /// Adds the file references of an XML element; returns the name of the file that it includes.
    fn take(&mut self, element: &BytesStart) -> quick_xml::Result<Option<String>> {
        let name = element.name();
        // MuJoCo 3.2 and later also read the file of `<asset><model>`
        let includes = [&b"include"[..], b"model"]
            .into_iter()
            .any(|read| name.as_ref().eq_ignore_ascii_case(read));
        let mut included = None;
        for attribute in element.attributes().with_checks(false) {
            let attribute = attribute?;
            let value = String::from_utf8_lossy(&attribute.value).trim().to_owned();
            match attribute.key.as_ref() {
                b"file" if includes => {
                    included.get_or_insert(value.clone());
                    self.files.push(value);
                }
                folder if folder.ends_with(b"dir") => self.folders.push(value),
                file if file.starts_with(b"file") => self.files.push(value),
                _ => {}
            }
        }
        Ok(included)
    }
}

/// Returns `true` if MuJoCo finds the file `given` for the value `value` of an XML attribute.
fn is_named(given: &str, value: &str) -> bool {
    given.eq_ignore_ascii_case(plain(value))
}

fn plain(path: &str) -> &str {
    path.rsplit(['/', '\\']).next().unwrap_or(path)
}

/// Returns `true` for an absolute path: from the root or from a drive.
fn is_absolute(value: &str) -> bool {
    value.starts_with(['/', '\\']) || value.as_bytes().get(1) == Some(&b':')
}

#[cfg(test)]
mod tests {
    use super::*;

    fn check(main: &str) -> Result<(), ModelError> {
        let obj = b"# file='/a' <mesh file='/tmp/cube.obj'/>\nv 0 0 0";
        reject_outside_references("main.xml", &[("main.xml", main.as_bytes()), ("Ball.obj", obj)])
    }

    fn assert_refused(result: Result<(), ModelError>, reason: &str) {
        let error = result.unwrap_err().to_string();
        assert!(error.contains(reason), "{error}");
    }

    #[test]
    fn absolute_paths_are_refused_unless_the_file_is_given() {
        for refused in [
            "<mesh file='/tmp/cube.obj'/>",
            "<texture fileright=\"/tmp/sky.png\"/>",
            "<mesh file='C:\\cube.obj'/>",
            "<compiler meshdir=\"/tmp\"/><mesh file='cube.obj'/>",
            "<mesh file='cube.obj'/><compiler\n meshdir = '/tmp' >",
            "<!-- --> <mesh file='/tmp/cube.obj'/>",
            "<body name='<!--'/><mesh file='/tmp/cube.obj'/><body name='-->'/>",
            "<body name='a>b' x=\"<'\"/><mesh file='/tmp/cube.obj'/>",
            "<![CDATA[<!--]]><mesh file='/tmp/cube.obj'/><!-- -->",
            "<?xml a='<!--'?><mesh file='/tmp/cube.obj'/><!-- -->",
        ] {
            assert_refused(check(refused), "absolute path");
        }
        for accepted in [
            "<mesh file='/tmp/ball.obj'/>",
            "<mesh file='cube.obj'/>",
            "<compiler meshdir='meshes'/>",
            "<compiler meshdir='/tmp'/>",
            "<compiler meshdir='/tmp'/><mesh file='ball.obj'/>",
            "<!-- <mesh file='/tmp/cube.obj'/> -->",
            "<![CDATA[ <mesh file='/tmp/cube.obj'/> ]]>",
            "file='/tmp/cube.obj'",
            "<body name='/tmp'/>",
            "<body name=\"file='/tmp/cube.obj'\"/>",
        ] {
            assert_eq!(check(accepted), Ok(()), "{accepted}");
        }
    }

    #[test]
    fn what_cannot_be_read_is_refused() {
        for (refused, reason) in [
            ("<a/>\n<!-- <a/>", "line 2"),
            ("<![CDATA[<a/>", "line 1"),
            ("<a b='1", "line 1"),
            ("<a/>\n<mesh\u{b}file='/tmp/cube.obj'/>", "line 2"),
            ("<mesh name='a'\u{c}file='/tmp/cube.obj'/>", "0x0c"),
            ("<a <mesh file='/tmp/cube.obj'/>", "line 1"),
            ("< mesh file='/tmp/cube.obj'/>", "line 1"),
            ("<!DOCTYPE a [ > <mesh file='/tmp/cube.obj'/> ]>", "a document type"),
        ] {
            assert_refused(check(refused), reason);
        }
        assert_eq!(check("no XML"), Ok(()));
    }

    #[test]
    fn names_that_end_with_a_slash_are_refused() {
        for refused in ["<include file='task.xml//'/>", "<mesh file='meshes\\\\'/>"] {
            assert_refused(check(refused), "nothing follows");
        }
    }

    #[test]
    fn character_references_in_paths_are_refused() {
        for refused in ["<mesh file='&#47;tmp/cube.obj'/>", "<include file='a&#46;xml'/>"] {
            assert_refused(check(refused), "character reference");
        }
        assert_eq!(check("<body name='a&amp;b'/>"), Ok(()));
    }

    #[test]
    fn what_is_included_is_looked_at_and_nothing_else() {
        let main = b"<Include file='sub/Part.xml'/>";
        let part = b"<include file='main.xml'/><compiler meshdir='/tmp'/>";
        let [bad, good]: [&[u8]; 2] = [b"<mesh file='cube.obj'/>", b"<include file='deep.xml'/>"];
        let check = |files: &[(&str, &[u8])]| reject_outside_references("main.xml", files);
        let start: [(&str, &[u8]); 2] = [("main.xml", main), ("part.xml", part)];
        assert_eq!(check(&start), Ok(()));
        assert_eq!(check(&[start[0], start[1], ("other.xml", bad)]), Ok(()));
        let deep = [b"<include file='deep.xml'/>".as_slice(), part].concat();
        assert_refused(check(&[start[0], ("part.xml", &deep), ("deep.xml", bad)]), "absolute path");
        let model: (&str, &[u8]) = ("main.xml", b"<asset><model file='part.xml'/></asset>");
        assert_refused(check(&[model, ("part.xml", b"<mesh file='/tmp/cube.obj'/>")]), "absolute");
        // without the file that it includes
        assert_refused(check(&[start[0], start[1], ("Part.XML", good)]), "absolute path");
    }
}
