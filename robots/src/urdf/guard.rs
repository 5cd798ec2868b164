//! What is refused before any parser sees it: parsers of XML recurse, and take long over long
//! files, and readers of URDF skip what `xacro` would have expanded. `RustyXML`, which `urdf-rs`
//! reads with, panics over some texts that no URDF needs.

use super::scan::{Kind, Piece, Pieces, Tag};
use crate::error::DescriptionError;

/// Most bytes of a URDF.
pub const MAX_BYTES: usize = 2 << 20;
/// Most levels of elements inside elements.
pub const MAX_DEPTH: usize = 64;
/// Most namespaces that a URDF may declare.
const MAX_NAMESPACES: usize = 32;

/// Refuses a text that is too long, too deep, a template, or unlike a URDF.
pub(super) fn check(text: &str) -> Result<(), DescriptionError> {
    if text.len() > MAX_BYTES {
        return Err(DescriptionError::TooLong { limit: MAX_BYTES });
    }
    let mut pieces = Pieces::new(text);
    let mut elements = Elements::default();
    let mut templates = Templates::default();
    while let Some(piece) = pieces.next() {
        if let Ok(Piece::Tag(tag)) = &piece
            && let Some(found) = templates.find(tag, elements.open.len())
        {
            let line = pieces.first_line();
            return Err(DescriptionError::Xacro { line, found });
        }
        let checked = piece.and_then(|piece| elements.check(&piece));
        checked.map_err(|reason| DescriptionError::Syntax {
            message: format!("line {}: {reason}", pieces.line()),
        })?;
        if elements.open.len() > MAX_DEPTH {
            return Err(DescriptionError::TooDeep { limit: MAX_DEPTH });
        }
    }
    Ok(())
}

/// Elements of xacro below `<robot>` that old files write without a prefix.
const OLD_XACRO: [&str; 6] = [
    "if",
    "include",
    "insert_block",
    "macro",
    "property",
    "unless",
];
/// Most characters of an attribute's value in a message; of longer ones it quotes what xacro would
/// have expanded.
const MAX_QUOTED: usize = 80;

/// Search for what `xacro` would have expanded. A declaration of its namespace alone is none of
/// that: the tool leaves it in its output.
#[derive(Default)]
struct Templates<'a> {
    /// Prefixes that are declared for xacro's namespace, beside `xacro` itself.
    prefixes: Vec<&'a str>,
}

impl<'a> Templates<'a> {
    /// The element or attribute of a tag, `level` elements deep, that is xacro.
    fn find(&mut self, tag: &Tag<'a>, level: usize) -> Option<String> {
        for &[name, value] in &tag.attributes {
            if !value.to_ascii_lowercase().ends_with("/xacro") {
                continue;
            }
            if name == "xmlns" {
                return Some(quoted(tag.name, name, value));
            }
            self.prefixes.extend(name.strip_prefix("xmlns:"));
        }
        let is_old = level == 1 && OLD_XACRO.contains(&tag.name);
        if is_old || self.is_prefixed(tag.name) {
            return Some(format!("`<{}>`", tag.name));
        }
        let mut attributes = tag.attributes.iter();
        let [name, value] = attributes
            .find(|[name, value]| self.is_prefixed(name) || unexpanded(value).is_some())?;
        Some(quoted(tag.name, name, value))
    }

    fn is_prefixed(&self, name: &str) -> bool {
        let prefix = name.split_once(':').map(|(prefix, _)| prefix);
        prefix.is_some_and(|prefix| prefix == "xacro" || self.prefixes.contains(&prefix))
    }
}

/// Place of a value at which xacro would have expanded something.
fn unexpanded(value: &str) -> Option<usize> {
    let starts = ["${", "$("]
        .into_iter()
        .filter_map(|start| value.find(start));
    starts.min()
}

/// An attribute for a message.
fn quoted(element: &str, name: &str, value: &str) -> String {
    let start = match value.chars().nth(MAX_QUOTED) {
        Some(_) => unexpanded(value).unwrap_or(0),
        None => 0,
    };
    let value: String = value[start..].chars().take(MAX_QUOTED).collect();
    format!("`{name}` of `<{element}>`, {value:?},")
}

/// The elements that have not ended.
#[derive(Default)]
struct Elements<'a> {
    open: Vec<&'a str>,
    /// Whether the root has started.
    started: bool,
    /// How many have been declared.
    namespaces: usize,
}

impl<'a> Elements<'a> {
    fn check(&mut self, piece: &Piece<'a>) -> Result<(), String> {
        let outside = self.open.is_empty();
        match piece {
            Piece::Text(text) if outside && !text.trim().is_empty() => Err(ALONE.to_owned()),
            Piece::Text(_) => Ok(()),
            Piece::Tag(tag) if outside && (self.started || tag.name != "robot") => {
                Err(ALONE.to_owned())
            }
            Piece::Tag(tag) => {
                self.nest(tag)?;
                self.declare(tag)?;
                attributes(tag)
            }
        }
    }

    /// The parser copies all namespaces for each element that it writes.
    fn declare(&mut self, tag: &Tag) -> Result<(), String> {
        let names = tag.attributes.iter().map(|[name, _]| name);
        self.namespaces += names.filter(|name| name.starts_with("xmlns")).count();
        if self.namespaces > MAX_NAMESPACES {
            return Err(format!(
                "more than {MAX_NAMESPACES} namespaces are declared"
            ));
        }
        Ok(())
    }

    fn nest(&mut self, tag: &Tag<'a>) -> Result<(), String> {
        self.started = true;
        match tag.kind {
            Kind::Start => self.open.push(tag.name),
            Kind::Empty => {}
            Kind::End => {
                if self.open.pop() != Some(tag.name) {
                    return Err(format!("`</{}>` ends what has not started", tag.name));
                }
            }
        }
        Ok(())
    }
}

/// What a file must be.
const ALONE: &str = "expected one `<robot>` and, around it, only blanks and comments";

fn attributes(tag: &Tag) -> Result<(), String> {
    tag.attributes.iter().try_for_each(|&[name, value]| {
        if name == "xmlns:xmlns" {
            return Err("`xmlns:xmlns` is XML's own and cannot be declared".to_owned());
        }
        let place = [tag.name, name].map(without_prefix);
        if place == ["origin", "quat_xyzw"] {
            return Err("`quat_xyzw` of `<origin>` is not supported; give `rpy`".to_owned());
        }
        if VECTORS.contains(&place) && !is_vector(value) {
            let [element, name] = place;
            return Err(format!(
                "`{name}` of `<{element}>` is {value:?}, expected three numbers with blanks \
                 between"
            ));
        }
        Ok(())
    })
}

/// Elements and those of their attributes that hold vectors.
const VECTORS: [[&str; 2]; 5] = [
    ["origin", "xyz"],
    ["origin", "rpy"],
    ["axis", "xyz"],
    ["box", "size"],
    ["mesh", "scale"],
];

fn without_prefix(name: &str) -> &str {
    name.rsplit_once(':').map_or(name, |(_, local)| local)
}

/// `urdf-rs` skips what is no number as long as three others are left.
fn is_vector(value: &str) -> bool {
    let numbers = || value.split_whitespace().map(str::parse::<f64>);
    numbers().count() == 3 && numbers().all(|number| number.is_ok())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn levels_are_counted_past_comments_and_attributes() {
        let nested = |levels: usize| {
            let open = r#"<a x="/>" y='">' z = "1"><!-- <b><c> --><b/>"#.repeat(levels - 1);
            let close = "</a\n>".repeat(levels - 1);
            format!("<?xml version=\"1.0\"?>\n<!----><robot>{open}<!-->{close}-->{close}</robot>")
        };
        check(&nested(MAX_DEPTH)).unwrap();
        let error = check(&nested(MAX_DEPTH + 1)).unwrap_err();
        assert!(matches!(error, DescriptionError::TooDeep { .. }), "{error}");
    }

    #[test]
    fn what_parsers_could_read_otherwise_is_refused() {
        for inside in [
            "<",
            "<a",
            "< a/>",
            "<a/ >",
            "<a b/>",
            "<a b=1/>",
            "<a b='1\"/>",
            "<a=\"1\"/>",
            "</a>",
            "<a></b>",
            "<:a/>",
            "<a:b:c/>",
            "<a: b='1'/>",
            "<!-- ",
            "<a></a b='1'>",
            "<a></a/>",
        ] {
            let error = check(&format!("<robot>{inside}</robot>")).unwrap_err();
            let is_syntax = matches!(error, DescriptionError::Syntax { .. });
            assert!(is_syntax, "{inside}: {error}");
        }
    }
}
