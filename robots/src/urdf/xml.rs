//! XML of a URDF: parsed by `roxmltree`, validated, and rewritten for `urdf-rs`.
//!
//! `RustyXML`, the parser of `urdf-rs`, panics on some texts, and URDF readers silently skip
//! unexpanded `xacro`. So `urdf-rs` gets only elements and their attributes, without namespaces,
//! comments and text.

use roxmltree::{Attribute, Document, Error, Node, ParsingOptions};

use crate::error::DescriptionError;
use crate::mjcf::xml_escaped;

/// Maximum size of a URDF (bytes).
pub const MAX_URDF_BYTES: usize = 2 << 20;
/// Maximum nesting depth of elements.
pub const MAX_XML_DEPTH: usize = 64;
/// Maximum number of elements, texts and comments.
const MAX_NODES: u32 = 1 << 18;
/// Maximum number of namespaces that a URDF may declare, since each element may copy them.
const MAX_NAMESPACES: usize = 32;
/// Maximum number of attributes of an element, since each is compared with all others.
const MAX_ATTRIBUTES: usize = 1000;

/// Elements of xacro that old files write without a prefix, directly below `<robot>`.
const OLD_XACRO: [&str; 6] = ["if", "include", "insert_block", "macro", "property", "unless"];
/// Maximum number of characters of an attribute's value in a message. Longer values are quoted from
/// the first unexpanded xacro expression on.
const MAX_QUOTED: usize = 80;
/// Elements and attributes that hold vectors of three numbers.
const VECTORS: [[&str; 2]; 5] =
    [["origin", "xyz"], ["origin", "rpy"], ["axis", "xyz"], ["box", "size"], ["mesh", "scale"]];

/// Rewrites the elements of a URDF as plain XML that every parser reads alike.
///
/// # Errors
/// [`DescriptionError::FileTooLong`], [`DescriptionError::XmlTooDeep`], [`DescriptionError::Xacro`]
/// for a template, and [`DescriptionError::InvalidSyntax`] for whatever is no URDF.
pub(super) fn elements(text: &str) -> Result<String, DescriptionError> {
    if text.len() > MAX_URDF_BYTES {
        return Err(DescriptionError::FileTooLong { limit: MAX_URDF_BYTES });
    }
    let text = without_comments(text)?;
    // rough counts, taken before the parsing whose cost they limit
    if text.matches("xmlns").count() > MAX_NAMESPACES {
        return syntax(format!("more than {MAX_NAMESPACES} namespaces are declared"));
    }
    let is_crowded = |tag: &str| tag.matches('=').count() > MAX_ATTRIBUTES;
    if text.split('<').any(is_crowded) {
        return syntax(format!("an element has more than {MAX_ATTRIBUTES} attributes"));
    }
    let options = ParsingOptions { nodes_limit: MAX_NODES, ..ParsingOptions::default() };
    let document = Document::parse_with_options(&text, options).or_else(|error| match error {
        Error::UnknownNamespace(prefix, position) if prefix == "xacro" => {
            Err(DescriptionError::Xacro {
                line: position.row as usize,
                found: "the prefix `xacro`".to_owned(),
            })
        }
        Error::UnknownToken(_) | Error::NoRootNode => syntax(format!("{error}; {ALONE}")),
        error => syntax(error.to_string()),
    })?;
    if document.root_element().tag_name().name() != "robot" {
        return syntax(ALONE.to_owned());
    }
    let mut urdf = Urdf { document: &document, text: String::new() };
    urdf.write(document.root_element(), 1)?;
    Ok(urdf.text)
}

/// Expectation in the message about a file that is not one `<robot>` element.
const ALONE: &str = "expected one `<robot>` and, around it, only blanks and comments";

fn syntax<T>(message: String) -> Result<T, DescriptionError> {
    Err(DescriptionError::InvalidSyntax { message })
}

/// Removes comments between tags; lines keep their numbers. Text that looks like a comment inside a
/// tag, CDATA or an instruction is left to the parser.
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
            kept += markup;
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

/// Document, and the text that is rewritten from it.
struct Urdf<'a> {
    document: &'a Document<'a>,
    text: String,
}

impl Urdf<'_> {
    /// Writes an element at depth `level`, without elements and attributes of other namespaces.
    fn write(&mut self, element: Node, level: usize) -> Result<(), DescriptionError> {
        if level > MAX_XML_DEPTH {
            return Err(DescriptionError::XmlTooDeep { limit: MAX_XML_DEPTH });
        }
        let line = || self.document.text_pos_at(element.range().start).row as usize;
        if let Some(found) = self.template(element, level) {
            let line = line();
            return Err(DescriptionError::Xacro { line, found });
        }
        let start = self.text.len();
        let name = element.tag_name().name();
        self.text += &format!("<{name}");
        for attribute in element.attributes() {
            if let Some(problem) = problem(name, &attribute) {
                return syntax(format!("line {}: {problem}", line()));
            }
            if attribute.namespace().is_none() {
                let value = xml_escaped(attribute.value());
                self.text += &format!(" {}=\"{value}\"", attribute.name());
            }
        }
        self.text.push('>');
        for child in element.children().filter(Node::is_element) {
            self.write(child, level + 1)?;
        }
        self.text += &format!("</{name}>");
        // removed only now, so that xacro inside the element is rejected, too
        let root = self.document.root_element().tag_name().namespace();
        if element.tag_name().namespace() != root {
            self.text.truncate(start);
        }
        Ok(())
    }

    /// Describes the element, or one of its attributes, that `xacro` should have expanded, if
    /// there is one.
    fn template(&self, element: Node, level: usize) -> Option<String> {
        // a declaration of the namespace is no template: xacro leaves it in its output
        let text = self.document.input_text();
        let name = &text[element.range()][1..];
        let end = name.find(|c: char| c.is_whitespace() || "/>".contains(c));
        let name = &name[..end.unwrap_or(name.len())];
        let is_old = level == 2 && OLD_XACRO.contains(&name);
        if is_old || is_xacro(element.tag_name().namespace(), name) {
            return Some(format!("`<{name}>`"));
        }
        element.attributes().find_map(|attribute| {
            let full = text.get(attribute.range_qname()).unwrap_or(attribute.name());
            let value = attribute.value();
            let is_template = is_xacro(attribute.namespace(), full) || unexpanded(value).is_some();
            is_template.then(|| format!("`{full}` of `<{name}>`, {:?},", quoted(value)))
        })
    }
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

/// Describes why an attribute is rejected. `None` if it is accepted.
fn problem(element: &str, attribute: &Attribute) -> Option<String> {
    let (name, value) = (attribute.name(), attribute.value());
    if [element, name] == ["origin", "quat_xyzw"] {
        return Some("`quat_xyzw` of `<origin>` is not supported; give `rpy`".to_owned());
    }
    (VECTORS.contains(&[element, name]) && !is_vector(value)).then(|| {
        format!(
            "`{name}` of `<{element}>` is {value:?}, expected three numbers with blanks between"
        )
    })
}

/// Returns `true` if a value consists of three numbers.
fn is_vector(value: &str) -> bool {
    // `urdf-rs` would skip anything else between three numbers
    let numbers = || value.split_whitespace().map(str::parse::<f64>);
    numbers().count() == 3 && numbers().all(|number| number.is_ok())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn levels_are_counted_past_comments_and_attributes() {
        let nested = |levels: usize| {
            let open = r#"<a x="/>" y='">' z = "1"><!-- <b><c> --><b/>"#.repeat(levels - 2);
            let close = "</a\n>".repeat(levels - 2);
            format!("<?xml version=\"1.0\"?>\n<!----><robot>{open}<!-->{close}-->{close}</robot>")
        };
        elements(&nested(MAX_XML_DEPTH)).unwrap();
        let error = elements(&nested(MAX_XML_DEPTH + 1)).unwrap_err();
        assert!(matches!(error, DescriptionError::XmlTooDeep { .. }), "{error}");
    }

    #[test]
    fn elements_of_the_same_namespace_are_left() {
        let text = "\u{feff}<?xml version='1.0'?>\n<!-- - -- --->\n<robot xmlns:g='g' name='a'>\
                    <?p '?>text<![CDATA[<b/>]]>\n<link g:x='1' name='&lt;&#x41;\"'/><g:link>\
                    <link name='b'/></g:link></robot>\n";
        let expected = "<robot name=\"a\"><link name=\"&lt;A&quot;\"></link></robot>";
        assert_eq!(elements(text).unwrap(), expected);
    }

    #[test]
    fn comments_are_removed_where_they_are_comments() {
        let between = "<![CDATA[<!--]]><link name='a'/><![CDATA[-->]]><?p <!-- ?><b/><?q --> ?>";
        let expected = "<robot><link name=\"a\"></link><b></b></robot>";
        assert_eq!(elements(&format!("<robot>{between}</robot>")).unwrap(), expected);
        let crowded = format!("<!-- {} -->", "= xmlns ".repeat(2 * MAX_ATTRIBUTES));
        elements(&format!("<robot>{crowded}</robot>")).unwrap();
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
            let error = elements(&format!("<robot>{inside}</robot>")).unwrap_err();
            let is_syntax = matches!(error, DescriptionError::InvalidSyntax { .. });
            assert!(is_syntax, "{inside}: {error}");
        }
    }
}
