//! XML of a URDF: parsed by `roxmltree`, and elements that name themselves in errors.

use glam::DVec3;
use roxmltree::{Document, Error, Node, ParsingOptions};

use crate::error::{DescriptionError, LARGEST};
use crate::pose::Pose;

/// Maximum size of a URDF (bytes).
pub const MAX_BYTES: usize = 2 << 20;
/// Maximum number of elements, texts and comments.
pub(super) const MAX_NODES: u32 = 1 << 18;
/// Maximum number of namespaces that a URDF may declare, since each element may copy them.
const MAX_NAMESPACES: usize = 32;
/// Maximum number of attributes of an element, since each is compared with all others.
const MAX_ATTRIBUTES: usize = 1000;

/// Elements that are skipped with everything inside, so that they may hold anything.
const SKIPPED: [&str; 6] =
    ["gazebo", "material", "ros2_control", "sensor", "transmission", "visual"];
/// Elements of xacro that old files write without a prefix, directly below `<robot>`.
const OLD_XACRO: [&str; 6] = ["if", "include", "insert_block", "macro", "property", "unless"];
/// Maximum number of characters of an attribute's value in a message. Longer values are quoted from
/// the first unexpanded xacro expression on.
const MAX_QUOTED: usize = 80;

/// Decodes a file: UTF-16, UTF-8, or else Latin-1.
pub(super) fn decode(bytes: Vec<u8>) -> String {
    let wide = |read: fn([u8; 2]) -> u16| {
        let units: Vec<u16> = bytes.as_chunks().0.iter().map(|&unit| read(unit)).collect();
        String::from_utf16_lossy(&units)
    };
    match bytes[..] {
        // a byte order mark, or the start of a tag
        [0xff, 0xfe, ..] | [b'<', 0, ..] => wide(u16::from_le_bytes),
        [0xfe, 0xff, ..] | [0, b'<', ..] => wide(u16::from_be_bytes),
        // files often declare another encoding than they have, so the bytes decide
        _ => String::from_utf8(bytes)
            .unwrap_or_else(|error| error.into_bytes().into_iter().map(char::from).collect()),
    }
}

/// Returns the text without comments and declaration, and with all its prefixes declared. Lines
/// keep their numbers.
///
/// # Errors
/// [`DescriptionError::TooLong`], [`DescriptionError::Syntax`].
pub(super) fn prepared(text: &str) -> Result<String, DescriptionError> {
    if text.len() > MAX_BYTES {
        return Err(DescriptionError::TooLong { limit: MAX_BYTES });
    }
    let mut text = without_comments(text)?;
    // rough counts, taken before the parsing whose cost they limit
    if text.matches("xmlns").count() > MAX_NAMESPACES {
        return syntax(format!("more than {MAX_NAMESPACES} namespaces are declared"));
    }
    let is_crowded = |tag: &str| tag.matches('=').count() > MAX_ATTRIBUTES;
    if text.split('<').any(is_crowded) {
        return syntax(format!("an element has more than {MAX_ATTRIBUTES} attributes"));
    }
    // old files use prefixes of tools, such as `<sensor:camera>`, without a declaration
    for _ in 0..MAX_NAMESPACES {
        let parsed = Document::parse_with_options(&text, options());
        let (Err(Error::UnknownNamespace(prefix, _)), Some(root)) = (parsed, text.find("<robot"))
        else {
            break;
        };
        if prefix == "xacro" {
            break;
        }
        text.insert_str(root + "<robot".len(), &format!(" xmlns:{prefix}=\"unknown:{prefix}\""));
    }
    Ok(text)
}

/// Parses a prepared text.
///
/// # Errors
/// [`DescriptionError::Xacro`] for a template, [`DescriptionError::Syntax`].
pub(super) fn parse(text: &str) -> Result<Document<'_>, DescriptionError> {
    Document::parse_with_options(text, options()).or_else(|error| match error {
        Error::UnknownNamespace(prefix, position) if prefix == "xacro" => {
            Err(DescriptionError::Xacro {
                line: position.row as usize,
                found: "the prefix `xacro`".to_owned(),
            })
        }
        Error::UnknownToken(_) | Error::NoRootNode => {
            syntax(format!("line {}: {ALONE}", error.pos().row))
        }
        error => syntax(format!("line {}: broken XML, {error}", error.pos().row)),
    })
}

/// Returns the element `<robot>`, which must be the root and hold no xacro where it is read.
///
/// # Errors
/// [`DescriptionError::Xacro`] for a template, [`DescriptionError::Syntax`].
pub(super) fn robot<'a>(document: &'a Document<'a>) -> Result<Element<'a>, DescriptionError> {
    let root = document.root_element();
    let name = root.tag_name().name();
    if name != "robot" {
        return syntax(format!("`<{name}>` is not URDF: {ALONE}"));
    }
    let mut open = vec![root];
    while let Some(node) = open.pop() {
        if let Some(found) = template(node) {
            return Err(DescriptionError::Xacro { line: Element(node).line(), found });
        }
        if !SKIPPED.contains(&node.tag_name().name()) {
            open.extend(node.children().filter(Node::is_element).rev());
        }
    }
    Ok(Element(root))
}

fn options<'a>() -> ParsingOptions<'a> {
    ParsingOptions { allow_dtd: true, nodes_limit: MAX_NODES, ..ParsingOptions::default() }
}

/// Expectation in the message about a file that is not one `<robot>` element.
const ALONE: &str = "expected one `<robot>` and, around it, only blanks and comments";

fn syntax<T>(message: String) -> Result<T, DescriptionError> {
    Err(DescriptionError::Syntax { message })
}

/// Removes comments between tags, and the declaration; lines keep their numbers. Text that looks
/// like a comment inside a tag, CDATA or an instruction is left to the parser.
fn without_comments(text: &str) -> Result<String, DescriptionError> {
    // many files are decorated with comments that hold `--`, which XML forbids
    let (mut kept, mut rest) = (String::with_capacity(text.len()), text);
    while let Some(at) = rest.find('<') {
        let (before, markup) = rest.split_at(at);
        kept += before;
        if let Some(inside) = markup.strip_prefix("<!--") {
            let Some((comment, after)) = inside.split_once("-->") else {
                return syntax("a comment has no end".to_owned());
            };
            kept.extend(comment.chars().filter(|&character| character == '\n'));
            rest = after;
        } else {
            let (markup, after) = markup.split_at(markup_len(markup));
            // a comment may stand before the declaration, and the text is decoded already
            let is_declaration = markup.starts_with("<?xml ");
            kept.extend(markup.chars().filter(|&character| !is_declaration || character == '\n'));
            rest = after;
        }
    }
    Ok(kept + rest)
}

/// Returns the length of the tag, CDATA or instruction at the start of a text, or that of the text
/// if it has no end.
fn markup_len(text: &str) -> usize {
    let up_to = |end: &str| text.find(end).map(|at| at + end.len());
    let end = if text.starts_with("<![CDATA[") {
        up_to("]]>")
    } else if text.starts_with("<?") {
        up_to("?>")
    } else {
        end_of_tag(text)
    };
    end.unwrap_or(text.len())
}

/// Returns the position after the first `>` outside of quotes. `None` if there is none.
fn end_of_tag(text: &str) -> Option<usize> {
    let mut quote = None;
    for (at, byte) in text.bytes().enumerate() {
        match (quote, byte) {
            (None, b'>') => return Some(at + 1),
            (None, b'\'' | b'"') => quote = Some(byte),
            (Some(open), _) if open == byte => quote = None,
            _ => (),
        }
    }
    None
}

/// Describes the element, or one of its attributes, that `xacro` should have expanded, if there is
/// one.
fn template(node: Node) -> Option<String> {
    // a declaration of the namespace is no template: xacro leaves it in its output
    let text = node.document().input_text();
    let name = text.get(node.range().start + 1..).unwrap_or_default();
    let end = name.find(|c: char| c.is_whitespace() || "/>".contains(c));
    let name = &name[..end.unwrap_or(name.len())];
    let root = Some(node.document().root_element());
    let is_old = node.parent() == root && OLD_XACRO.contains(&name);
    if is_old || is_xacro(node.tag_name().namespace(), name) {
        return Some(format!("`<{name}>`"));
    }
    node.attributes().find_map(|attribute| {
        let full = text.get(attribute.range_qname()).unwrap_or(attribute.name());
        let value = attribute.value();
        let is_template = is_xacro(attribute.namespace(), full) || unexpanded(value).is_some();
        is_template.then(|| format!("`{full}` of `<{name}>`, {:?},", quoted(value)))
    })
}

/// Returns `true` if an element or attribute belongs to xacro, by its namespace or prefixed name.
fn is_xacro(namespace: Option<&str>, name: &str) -> bool {
    let namespace = namespace.unwrap_or_default().to_ascii_lowercase();
    namespace.ends_with("/xacro") || name.starts_with("xacro:")
}

/// Returns the position of the first unexpanded xacro expression in a value, if there is one.
fn unexpanded(value: &str) -> Option<usize> {
    value.find("${").into_iter().chain(value.find("$(")).min()
}

/// Returns at most [`MAX_QUOTED`] characters of a value, for a message.
fn quoted(value: &str) -> String {
    let is_long = value.chars().nth(MAX_QUOTED).is_some();
    let start = if is_long { unexpanded(value) } else { None };
    value[start.unwrap_or(0)..].chars().take(MAX_QUOTED).collect()
}

/// Value that is read, or the error.
pub(super) type Found<T> = Result<T, DescriptionError>;

/// Element of a URDF. Elements and attributes of other namespaces than `<robot>`'s are skipped.
#[derive(Clone, Copy)]
pub(super) struct Element<'a>(Node<'a, 'a>);

impl<'a> Element<'a> {
    pub(super) fn children(self, name: &'static str) -> impl Iterator<Item = Self> {
        let root = self.0.document().root_element().tag_name().namespace();
        let named = move |node: &Node| {
            let tag = node.tag_name();
            node.is_element() && tag.name() == name && tag.namespace() == root
        };
        self.0.children().filter(named).map(Self)
    }

    pub(super) fn child(self, name: &'static str) -> Option<Self> {
        self.children(name).next()
    }

    pub(super) fn text(self, attribute: &str) -> Option<&'a str> {
        self.0.attribute(attribute)
    }

    pub(super) fn name(self) -> &'a str {
        self.text("name").unwrap_or_default()
    }

    /// Returns an attribute of a child; both must be there.
    pub(super) fn text_of_child(self, [child, attribute]: [&'static str; 2]) -> Found<&'a str> {
        let found = self.child(child).ok_or_else(|| self.missing(&format!("`<{child}>`")))?;
        found.text(attribute).ok_or_else(|| found.missing(&format!("`{attribute}`")))
    }

    /// Returns a number, which may be infinite. `None` without the attribute.
    pub(super) fn any_number(self, name: &'static str) -> Found<Option<f64>> {
        let Some(text) = self.text(name) else {
            return Ok(None);
        };
        let number = text.trim().parse().ok().filter(|number: &f64| !number.is_nan());
        number.map(Some).ok_or_else(|| self.refused(name, "a number"))
    }

    /// Returns a number of at most 1e6; without the attribute, `missing`.
    pub(super) fn number(self, name: &'static str, missing: f64) -> Found<f64> {
        let number = self.any_number(name)?.unwrap_or(missing);
        self.require(number.abs() <= LARGEST, name, "a finite number up to 1e6")?;
        Ok(number)
    }

    /// Returns three numbers of at most 1e6; without the attribute, `missing`.
    pub(super) fn vector(self, name: &'static str, missing: DVec3) -> Found<DVec3> {
        let Some(text) = self.text(name) else {
            return Ok(missing);
        };
        let numbers: Option<Vec<f64>> =
            text.split_whitespace().map(|word| word.parse().ok()).collect();
        let numbers = numbers.filter(|numbers| numbers.iter().all(|n| n.abs() <= LARGEST));
        match numbers.as_deref() {
            Some(&[x, y, z]) => Ok(DVec3::new(x, y, z)),
            _ => Err(self.refused(name, "three numbers up to 1e6 with blanks between")),
        }
    }

    /// Returns the pose of the child `<origin>`; without it, the identity.
    pub(super) fn origin(self) -> Found<Pose> {
        let Some(origin) = self.child("origin") else {
            return Ok(Pose::IDENTITY);
        };
        if origin.text("quat_xyzw").is_some() {
            return Err(origin.refused("quat_xyzw", "`rpy` instead"));
        }
        let [xyz, rpy] = ["xyz", "rpy"].map(|name| origin.vector(name, DVec3::ZERO));
        Ok(Pose::from_xyz_rpy(xyz?.to_array(), rpy?.to_array()))
    }

    /// Rejects the value of an attribute unless `holds`.
    pub(super) fn require(
        self,
        holds: bool,
        name: &'static str,
        expected: &'static str,
    ) -> Found<()> {
        if holds { Ok(()) } else { Err(self.refused(name, expected)) }
    }

    pub(super) fn refused(self, name: &'static str, expected: &'static str) -> DescriptionError {
        let value = quoted(self.text(name).unwrap_or_default());
        self.at(DescriptionError::Attribute { place: self.place(), name, value, expected })
    }

    pub(super) fn missing(self, what: &str) -> DescriptionError {
        self.at(DescriptionError::Missing { place: self.place(), what: what.to_owned() })
    }

    /// Adds the element's line to an error.
    pub(super) fn at(self, error: DescriptionError) -> DescriptionError {
        DescriptionError::Line { line: self.line(), error: Box::new(error) }
    }

    pub(super) fn line(self) -> usize {
        self.0.document().text_pos_at(self.0.range().start).row as usize
    }

    /// Describes the element in a message, such as "`<limit>` of the joint `elbow`".
    pub(super) fn place(self) -> String {
        let tag = self.0.tag_name().name();
        let is_owner = |node: &Node| ["link", "joint"].contains(&node.tag_name().name());
        let Some(owner) = self.0.ancestors().find(is_owner).map(Self) else {
            return format!("`<{tag}>`");
        };
        let named = format!("the {} `{}`", owner.0.tag_name().name(), quoted(owner.name()));
        if owner.0 == self.0 { named } else { format!("`<{tag}>` of {named}") }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn encodings_are_told_by_their_bytes() {
        let text = "\u{feff}<robot name='Gr\u{f6}\u{df}e'/>";
        let units: Vec<u16> = text.encode_utf16().collect();
        let latin: Vec<u8> = text.chars().skip(1).map(|c| c as u8).collect();
        for bytes in [
            text.as_bytes().to_vec(),
            latin,
            units.iter().flat_map(|unit| unit.to_le_bytes()).collect(),
            units.iter().flat_map(|unit| unit.to_be_bytes()).collect(),
            units[1..].iter().flat_map(|unit| unit.to_le_bytes()).collect(),
        ] {
            let text = decode(bytes);
            let document = parse(&text).unwrap();
            assert_eq!(robot(&document).unwrap().name(), "Gr\u{f6}\u{df}e");
        }
    }

    /// Returns the names of the links.
    fn links(text: &str) -> Result<Vec<String>, DescriptionError> {
        let text = prepared(text)?;
        let document = parse(&text)?;
        Ok(robot(&document)?.children("link").map(|link| link.name().to_owned()).collect())
    }

    #[test]
    fn everything_around_the_links_is_skipped() {
        for (inside, names) in [
            ("<link g:x='1' name='&lt;&#x41;\"'/><g:link/><link name='b'/>", &["<A\"", "b"][..]),
            ("<![CDATA[<!--]]><link name='a'/><![CDATA[-->]]><?p <!-- ?><b/><?q --> ?>", &["a"]),
            ("<!-- - -- ---><link name='a'/>text<?p '?><![CDATA[<b/>]]>", &["a"]),
            ("<h:camera h:x='1'/><link name='a'/><i:j/>", &["a"]),
            ("<gazebo><xacro:grey/><a b='${c}'/></gazebo><link name='a'/>", &["a"]),
            ("<link name='&n;'/>", &["entity"]),
        ] {
            let head = "\n<!-- -- -->\n<?xml version='1.0' encoding='latin1'?>\n<!DOCTYPE robot \
                        [<!ENTITY n 'entity'>]>\n<robot xmlns:g='g' xmlns:xacro='x'>";
            assert_eq!(links(&format!("{head}{inside}</robot>\n")).unwrap(), names, "{inside}");
        }
        let crowded = format!("<!-- {} -->", "= xmlns ".repeat(2 * MAX_ATTRIBUTES));
        links(&format!("<robot>{crowded}</robot>")).unwrap();
    }

    #[test]
    fn what_is_no_xml_is_refused() {
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
            "<a:b:c/>",
            "<a: b='1'/>",
            "<!-- ",
            "<a></a b='1'>",
            "<a></a/>",
            "<a<!-- -->b/>",
            "<link name='a<!--x-->b'/>",
            "<a <!-- x --> b='1'/>",
        ] {
            let error = links(&format!("<robot>{inside}</robot>")).unwrap_err();
            let is_syntax = matches!(error, DescriptionError::Syntax { .. });
            assert!(is_syntax, "{inside}: {error}");
        }
    }
}
