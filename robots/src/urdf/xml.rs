//! XML of a URDF, cleaned for `urdf-rs`.
//!
//! `urdf-rs` panics on some texts, knows no lines, stops at its first error, and demands values
//! that real files lack or hold twice. So it gets only what [`READ`] lists, all of it valid.
//! Whatever is wrong is reported first, with its element and line.

use roxmltree::{Document, Error, Node, ParsingOptions};

use super::Report;
use crate::error::{DescriptionError, FROM_ZERO, MAX_NUMBER, is_bounded, is_bounded_from_zero};
use crate::fit::MIN_SHAPE_SIZE;
use crate::mjcf::xml_escaped;

/// Maximum size of a URDF (bytes).
pub const MAX_URDF_BYTES: usize = 2 << 20;
/// Maximum number of elements, texts and comments.
const MAX_NODES: u32 = 1 << 18;
/// Maximum number of namespaces that a URDF may declare, since each element may copy them.
const MAX_NAMESPACES: usize = 32;
/// Maximum number of attributes of an element, since each is compared with all others.
const MAX_ATTRIBUTES: usize = 1000;

/// Largest angle of `rpy` (radians) whose unit does not look wrong: just above a turn.
const LARGEST_ANGLE: f64 = 6.3;
/// Smallest size of the largest component of an axis that is accepted.
const SHORTEST_AXIS: f64 = 1e-6;
/// Elements that are skipped with everything inside, so that they may hold anything.
const SKIPPED: [&str; 6] =
    ["gazebo", "material", "ros2_control", "sensor", "transmission", "visual"];
/// Elements of xacro that old files write without a prefix, directly below `<robot>`.
const OLD_XACRO: [&str; 6] = ["if", "include", "insert_block", "macro", "property", "unless"];
/// Maximum number of characters of an attribute's value in a message. Longer values are quoted from
/// the first unexpanded xacro expression on.
const MAX_QUOTED: usize = 80;

/// Note on a file that is taken for Latin-1 and does not declare it.
const GUESSED_ENCODING: &str = "the file is not UTF-8, and is read as Latin-1, which it does not \
    declare: if names look wrong, save it as UTF-8; if not, begin it with \
    `<?xml version=\"1.0\" encoding=\"ISO-8859-1\"?>`";

/// Decodes the bytes of a text file: UTF-16, UTF-8, or else Latin-1.
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

/// Returns a note on bytes that [`decode`] took for `text` in Latin-1, unless they declare that.
pub(super) fn encoding_note(bytes: &[u8], text: &str) -> Option<&'static str> {
    // a byte of Latin-1 is a character; one of UTF-16 or UTF-8 beyond ASCII is none
    let is_latin = !text.is_ascii() && text.chars().count() == bytes.len();
    let declaration = text.split_once("?>").map_or("", |(head, _)| head).to_ascii_lowercase();
    let is_declared = ["latin", "8859-1", "1252"].iter().any(|name| declaration.contains(name));
    (is_latin && !is_declared).then_some(GUESSED_ENCODING)
}

/// URDF as `urdf-rs` accepts it, with the line numbers of its links and joints in the original.
pub(super) struct Cleaned {
    pub(super) text: String,
    pub(super) link_lines: Vec<usize>,
    pub(super) joint_lines: Vec<usize>,
}

/// Rewrites a URDF as `urdf-rs` accepts it. Missing and invalid values are reported and replaced,
/// so that the rest can be checked, too.
///
/// # Errors
/// [`DescriptionError::FileTooLong`], [`DescriptionError::Xacro`] for a template,
/// [`DescriptionError::InvalidSyntax`].
pub(super) fn clean(text: &str, report: &mut Report) -> Result<Cleaned, DescriptionError> {
    if text.len() > MAX_URDF_BYTES {
        return Err(DescriptionError::FileTooLong { limit: MAX_URDF_BYTES });
    }
    let written = parse(text, "robot", |robot| written(robot, report));
    written.unwrap_or_else(|message| Err(DescriptionError::InvalidSyntax { message }))
}

/// Parses an XML text that consists of the element `name`, and calls `read` with that element.
///
/// Comments and document types may hold anything but entities. Prefixes may lack a declaration, as
/// in `<sensor:camera>`. The error names the line.
pub(super) fn parse<T>(text: &str, name: &str, read: impl FnOnce(Node) -> T) -> Result<T, String> {
    // the text is decoded already, and a declaration may stand only at the start
    let mut text = without_comments(text)?.replacen("<?xml ", "<?was ", 1);
    // rough counts, taken before the parsing whose cost they limit
    let tags = || text.split('<');
    if tags().map(|tag| tag.matches("xmlns").count()).sum::<usize>() > MAX_NAMESPACES {
        return Err(format!("more than {MAX_NAMESPACES} namespaces are declared"));
    }
    if tags().any(|tag| tag.matches('=').count() > MAX_ATTRIBUTES) {
        return Err(format!("an element has more than {MAX_ATTRIBUTES} attributes"));
    }
    let alone = format!("expected one `<{name}>` and, around it, only blanks and comments");
    let start = format!("<{name}");
    for _ in 0..=MAX_NAMESPACES {
        let options =
            ParsingOptions { allow_dtd: true, nodes_limit: MAX_NODES, ..ParsingOptions::default() };
        let error = match Document::parse_with_options(&text, options) {
            Ok(document) if document.root_element().has_tag_name(name) => {
                return Ok(read(document.root_element()));
            }
            Ok(document) => {
                let found = document.root_element().tag_name().name();
                return Err(format!("it is `<{found}>`, {alone}"));
            }
            Err(error) => error,
        };
        let line = error.pos().row;
        match (error, text.find(&start)) {
            (Error::UnknownNamespace(prefix, _), Some(root)) => {
                let namespace = format!(" xmlns:{prefix}=\"unknown:{prefix}\"");
                text.insert_str(root + start.len(), &namespace);
            }
            (Error::UnknownToken(_) | Error::NoRootNode, _) => {
                return Err(format!("line {line}: {alone}"));
            }
            (Error::NodesLimitReached, _) => {
                return Err(format!("more than {MAX_NODES} elements, texts and comments"));
            }
            (error, _) => {
                let is_merged = text.contains("\n<<<<<<< ");
                let advice = if is_merged {
                    "the file has unresolved conflicts of Git (`<<<<<<<`); resolve them"
                } else {
                    "correct the tag or quote there"
                };
                return Err(format!("line {line}: this is not valid XML ({error}); {advice}"));
            }
        }
    }
    Err(format!("more than {MAX_NAMESPACES} prefixes are not declared"))
}

/// Start and end of a comment, and of other parts of XML that may hold anything.
const SECTIONS: [(&str, &str); 3] = [("<!--", "-->"), ("<![CDATA[", "]]>"), ("<?", "?>")];

/// Empties comments, since XML forbids two hyphens in them and many files are decorated so. Line
/// numbers stay.
///
/// Rejects entities, which may expand to gigabytes: URDF and COLLADA need none.
fn without_comments(text: &str) -> Result<String, String> {
    let (mut kept, mut rest) = (String::with_capacity(text.len()), text);
    while let Some(start) = rest.find('<') {
        let (before, tag) = rest.split_at(start);
        if tag.starts_with("<!ENTITY") {
            let line = 1 + text[..text.len() - tag.len()].matches('\n').count();
            return Err(format!(
                "line {line}: `<!ENTITY` declares an entity, and entities are not read; write \
                 their values where they are used"
            ));
        }
        kept += before;
        let Some((open, close)) = SECTIONS.iter().find(|(open, _)| tag.starts_with(open)) else {
            kept.push('<');
            rest = &tag[1..];
            continue;
        };
        let Some(length) = tag[open.len()..].find(close) else {
            rest = tag;
            break;
        };
        let (section, after) = tag.split_at(open.len() + length + close.len());
        if *open == "<!--" {
            kept += &format!("<!--{}-->", "\n".repeat(section.matches('\n').count()));
        } else {
            kept += section;
        }
        rest = after;
    }
    Ok(kept + rest)
}

/// Writes the element `<robot>`, which must hold no xacro where it is read.
fn written(root: Node, report: &mut Report) -> Result<Cleaned, DescriptionError> {
    let mut open = vec![root];
    while let Some(node) = open.pop() {
        if let Some(name) = constant(node) {
            let note = format!("`<{name}>` is xacro; nothing that is read uses its value");
            report.note(line(node), &note);
            continue;
        }
        if let Some(found) = template(node) {
            return Err(DescriptionError::Xacro { line: line(node), found });
        }
        if !SKIPPED.contains(&node.tag_name().name()) {
            open.extend(node.children().filter(Node::is_element).rev());
        }
    }
    let mut text = String::new();
    write(&mut text, "robot", Some(root), report);
    let lines = |tag| elements(root, tag).map(line).collect();
    Ok(Cleaned { text, link_lines: lines("link"), joint_lines: lines("joint") })
}

/// Returns the name with prefix of an element that only defines a constant of xacro. Its uses, if
/// there are any, are found by [`template`].
fn constant<'a>(node: Node<'a, 'a>) -> Option<&'a str> {
    let name = full_name(node);
    let is_definition = ["property", "xacro:property"].contains(&name)
        && node.parent() == Some(node.document().root_element())
        && !node.has_children()
        && node.attributes().all(|attribute| unexpanded(attribute.value()).is_none());
    is_definition.then_some(name)
}

/// Returns an element's name as the file has it, with its prefix.
fn full_name<'a>(node: Node<'a, 'a>) -> &'a str {
    let name = node.document().input_text().get(node.range().start + 1..).unwrap_or_default();
    let end = name.find(|c: char| c.is_whitespace() || "/>".contains(c));
    &name[..end.unwrap_or(name.len())]
}

/// Describes the element, or one of its attributes, that `xacro` should have expanded, if there is
/// one.
fn template(node: Node) -> Option<String> {
    // a declaration of the namespace is no template: xacro leaves it in its output
    let (text, name) = (node.document().input_text(), full_name(node));
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

/// Elements that are read, with their attributes and the elements inside; `|` separates
/// alternatives. The first element of a name is read, or all in [`REPEATED`].
const READ: [(&str, &[&str], &[&str]); 18] = [
    ("robot", &["name"], &["link", "joint"]),
    ("link", &["name"], &["inertial", "collision"]),
    ("inertial", &[], &["origin", "mass", "inertia"]),
    ("mass", &["value"], &[]),
    ("inertia", &["ixx", "ixy", "ixz", "iyy", "iyz", "izz"], &[]),
    ("collision", &[], &["origin", "geometry"]),
    ("geometry", &[], &[SHAPES]),
    ("sphere", &["radius"], &[]),
    ("box", &["size"], &[]),
    ("cylinder|capsule", &["radius", "length"], &[]),
    ("mesh", &["filename", "scale"], &[]),
    ("joint", &["name", "type"], &OF_JOINT),
    ("origin", &["xyz", "rpy", "quat_xyzw"], &[]),
    ("axis", &["xyz"], &[]),
    ("limit", &["lower", "upper", "effort", "velocity"], &[]),
    ("dynamics", &["damping", "friction"], &[]),
    ("mimic", &["joint", "multiplier", "offset"], &[]),
    ("parent|child", &["link"], &[]),
];
const SHAPES: &str = "sphere|box|cylinder|capsule|mesh";
const OF_JOINT: [&str; 7] = ["origin", "axis", "limit", "dynamics", "mimic", "parent", "child"];
const OF_MOTION: [&str; 4] = ["axis", "limit", "dynamics", "mimic"];
const REPEATED: [&str; 3] = ["link", "joint", "collision"];
/// Attributes and elements without which a file is refused. Others have default values.
const REQUIRED_ATTRIBUTES: [&str; 11] =
    ["type", "link", "joint", "value", "filename", "radius", "length", "size", "ixx", "iyy", "izz"];
const SIZE_ATTRIBUTES: [&str; 3] = ["radius", "length", "size"];
const REQUIRED_ELEMENTS: [&str; 5] = ["mass", "geometry", SHAPES, "parent", "child"];
/// Elements that are known and not read.
const UNREAD: [&str; 4] = ["calibration", "contact_coefficients", "safety_controller", "verbose"];

const NUMBER: &str = "a finite number up to 1e6";
const VECTOR: &str = "three numbers up to 1e6 with blanks between";
const SCALE: &str = "three numbers up to 1e6, none of them zero";
const SIZE: &str = "1e-6 to 1e6 metres";
const SIZES: &str = "three numbers, each 1e-6 to 1e6 metres";
const KINDS: [&str; 4] = ["revolute", "continuous", "prismatic", "fixed"];

/// Returns the default of an attribute, a check of its value, and the values expected.
fn rule(element: &str, attribute: &str) -> (&'static str, fn(&str) -> bool, &'static str) {
    match (element, attribute) {
        (_, "name") => ("", |_| true, ""),
        (_, "link" | "joint" | "filename") => ("", |name| !name.is_empty(), "a name"),
        (_, "type") => {
            ("fixed", |kind| KINDS.contains(&kind), "revolute, continuous, prismatic or fixed")
        }
        (_, "lower" | "upper" | "effort" | "velocity") => {
            ("0", |text| all::<1>(text, |number| !number.is_nan()), "a number")
        }
        (_, "value" | "damping" | "friction") => {
            ("0", |text| all::<1>(text, is_bounded_from_zero), FROM_ZERO)
        }
        (_, "radius" | "length") => ("0", |text| all::<1>(text, is_bounded_from_zero), SIZE),
        (_, "size") => ("0 0 0", |text| all::<3>(text, is_bounded_from_zero), SIZES),
        ("axis", _) => ("1 0 0", is_axis, "a direction: three numbers, not all of them zero"),
        (_, "xyz" | "rpy") => ("0 0 0", |text| all::<3>(text, is_bounded), VECTOR),
        (_, "scale") => ("1 1 1", |text| all::<3>(text, |n| is_bounded(n) && n != 0.0), SCALE),
        (_, "quat_xyzw") => ("", |_| false, "`rpy` instead"),
        (_, "multiplier") => ("1", |text| all::<1>(text, is_bounded), NUMBER),
        _ => ("0", |text| all::<1>(text, is_bounded), NUMBER),
    }
}

/// Returns `true` if a text consists of N numbers, each of which `holds`.
fn all<const N: usize>(text: &str, holds: fn(f64) -> bool) -> bool {
    let numbers = || text.split_whitespace();
    numbers().count() == N && numbers().all(|number| number.parse().is_ok_and(holds))
}

/// Returns `true` if one of the sizes in a text is too small for MuJoCo.
fn is_small(sizes: &str) -> bool {
    let small = |size: f64| size < MIN_SHAPE_SIZE;
    sizes.split_whitespace().any(|size| size.parse().is_ok_and(small))
}

fn is_axis(text: &str) -> bool {
    all::<3>(text, is_bounded) && !all::<3>(text, |number| number.abs() < SHORTEST_AXIS)
}

/// Returns the value of an attribute, or its default where it is missing or, which is reported,
/// wrong.
fn value<'a>(
    element: &str,
    attribute: &str,
    node: Option<Node<'a, 'a>>,
    report: &mut Report,
) -> &'a str {
    let (default, holds, expected) = rule(element, attribute);
    let Some(node) = node else {
        return default;
    };
    // such a joint has no ends, whatever its `<limit>` says
    let around = node.parent().and_then(|around| around.attribute("type"));
    let is_unused = around == Some("continuous") && ["lower", "upper"].contains(&attribute);
    let Some(stated) = node.attribute(attribute).filter(|_| !is_unused) else {
        if REQUIRED_ATTRIBUTES.contains(&attribute) {
            reject(report, node, "", format!("has no `{attribute}`; add it"));
        }
        return default;
    };
    let problem = unexpected(stated, expected);
    if !holds(stated) {
        reject(report, node, attribute, problem);
        return default;
    }
    if attribute == "rpy" && !all::<3>(stated, |angle| angle.abs() < LARGEST_ANGLE) {
        let unit = "is the file in degrees instead of radians?";
        let warning =
            format!("line {}: {} is {stated:?}: {unit}", line(node), place(node, attribute));
        report.unit_warnings.push(warning);
    }
    if SIZE_ATTRIBUTES.contains(&attribute) && is_small(stated) {
        report.small_size(line(node), &format!("{} {problem}", place(node, attribute)));
    }
    stated
}

/// Notes what is not read of an element and may be a misspelt name: attributes of elements that hold
/// numbers, and elements inside of the robot, links, joints and collision shapes.
fn note_unread(node: Node, attributes: &[&str], children: &[&str], report: &mut Report) {
    const UNREAD_NOTE: &str = "is not read";
    let name = node.tag_name().name();
    // a name says nothing of an element that holds numbers
    let holds_numbers = children.is_empty() && !attributes.contains(&"link");
    for attribute in node.attributes().filter(|_| holds_numbers) {
        let known = attributes.contains(&attribute.name()) || attribute.name() == "name";
        if attribute.namespace().is_none() && !known {
            report.note(line(node), &format!("{} {UNREAD_NOTE}", place(node, attribute.name())));
        }
    }
    if ["robot", "link", "joint", "collision"].contains(&name) {
        let own = node.document().root_element().tag_name().namespace();
        let is_read =
            |of: &str| children.iter().any(|inside| inside.split('|').any(|one| one == of));
        for child in node.children().filter(Node::is_element) {
            let inside = child.tag_name();
            // a constant has a note of its own
            let is_known = SKIPPED.contains(&inside.name())
                || UNREAD.contains(&inside.name())
                || constant(child).is_some();
            let is_foreign = inside.namespace() != own;
            // foreign elements are of other tools, unless they look like something that is read
            if !is_known && is_foreign == is_read(inside.name()) {
                report.note(line(child), &format!("{} {UNREAD_NOTE}", place(child, "")));
            }
        }
    }
}

/// Writes an element with what is read of it; without `node`, one of default values.
fn write(text: &mut String, name: &str, node: Option<Node>, report: &mut Report) {
    let read = READ.iter().find(|(names, ..)| names.split('|').any(|of| of == name));
    let (_, attributes, children) = read.unwrap_or(&("", &[], &[]));
    if let Some(stated) = node {
        note_unread(stated, attributes, children, report);
    }
    *text += &format!("<{name}");
    for attribute in *attributes {
        let value = value(name, attribute, node, report);
        *text += &format!(" {attribute}=\"{}\"", xml_escaped(value));
    }
    text.push('>');
    // what a fixed joint says of its motion is often wrong, and never needed
    let is_fixed = node.and_then(|node| node.attribute("type")) == Some("fixed");
    for inside in children.iter().filter(|inside| !(is_fixed && OF_MOTION.contains(*inside))) {
        let found = node.into_iter().flat_map(|node| elements(node, inside));
        let found: Vec<Node> = found.collect();
        for (index, &child) in found.iter().enumerate() {
            if index == 0 || REPEATED.contains(inside) {
                write(text, child.tag_name().name(), Some(child), report);
            } else {
                let ignored = "is ignored, because an element before it is read instead";
                report.note(line(child), &format!("{} {ignored}", place(child, "")));
            }
        }
        let is_required = REQUIRED_ELEMENTS.contains(inside);
        // `urdf-rs` demands an inertia with every mass
        if found.is_empty() && (is_required || *inside == "inertia") {
            write(text, if *inside == SHAPES { "sphere" } else { inside }, None, report);
        }
        if let (Some(node), true) = (node, found.is_empty() && is_required) {
            let names = inside.replace('|', ">`, `<");
            reject(report, node, "", format!("has no `<{names}>`; add it"));
        }
    }
    *text += &format!("</{name}>");
    if let ("joint", Some(joint)) = (name, node) {
        check_limit(joint, report);
    }
}

fn check_limit(joint: Node, report: &mut Report) {
    if !matches!(joint.attribute("type"), Some("revolute" | "prismatic")) {
        return;
    }
    let Some(limit) = elements(joint, "limit").next() else {
        let is_hinge = joint.attribute("type") == Some("revolute");
        let other = if is_hinge { ", or make it continuous" } else { "" };
        let problem = format!("has no `<limit>` with `lower` and `upper`; add it{other}");
        return reject(report, joint, "", problem);
    };
    let texts = ["lower", "upper"].map(|end| limit.attribute(end).unwrap_or("0"));
    let [lower, upper] = texts.map(|end| end.trim().parse().unwrap_or(f64::NAN));
    if lower > upper {
        let place = place(limit, "lower");
        report.note(line(limit), &format!("{place} is above `upper`: {lower} to {upper}"));
    } else if lower >= MAX_NUMBER || upper <= -MAX_NUMBER {
        let end = if lower >= MAX_NUMBER { 0 } else { 1 };
        let problem = unexpected(texts[end], "a range with positions within 1e6 of zero");
        reject(report, limit, ["lower", "upper"][end], problem);
    }
}

fn unexpected(value: &str, expected: &str) -> String {
    format!("is {:?}, expected {expected}", quoted(value))
}

fn reject(report: &mut Report, node: Node, attribute: &str, problem: String) {
    let place = place(node, attribute);
    report.reject(line(node), DescriptionError::InvalidElement { place, problem });
}

/// Returns the elements of alternative names inside a node, without those of other namespaces than
/// `<robot>`'s.
fn elements<'a>(node: Node<'a, 'a>, names: &'static str) -> impl Iterator<Item = Node<'a, 'a>> {
    let root = node.document().root_element().tag_name().namespace();
    node.children().filter(move |child| {
        let tag = child.tag_name();
        let is_named = || names.split('|').any(|name| name == tag.name());
        child.is_element() && tag.namespace() == root && is_named()
    })
}

/// Returns the line at which a node starts.
fn line(node: Node) -> usize {
    node.document().text_pos_at(node.range().start).row as usize
}

/// Describes an element or, with a name, its attribute in a message, such as "`lower` of `<limit>`
/// of the joint `elbow`".
fn place(node: Node, attribute: &str) -> String {
    let of = if attribute.is_empty() { String::new() } else { format!("`{attribute}` of ") };
    let tag = node.tag_name().name();
    let is_owner = |around: &Node| ["link", "joint"].contains(&around.tag_name().name());
    let Some(owner) = node.ancestors().find(is_owner) else {
        return format!("{of}`<{tag}>`");
    };
    let name = quoted(owner.attribute("name").unwrap_or_default());
    let named = format!("the {} `{name}`", owner.tag_name().name());
    if owner == node { of + &named } else { format!("{of}`<{tag}>` of {named}") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn encodings_are_told_by_their_bytes() {
        let text = "\u{feff}<robot name='Gr\u{f6}\u{df}e'/>";
        let units: Vec<u16> = text.encode_utf16().collect();
        for bytes in [
            text.as_bytes().to_vec(),
            text.chars().skip(1).map(|c| c as u8).collect(),
            units.iter().flat_map(|unit| unit.to_le_bytes()).collect(),
            units.iter().flat_map(|unit| unit.to_be_bytes()).collect(),
            units[1..].iter().flat_map(|unit| unit.to_le_bytes()).collect(),
        ] {
            let cleaned = clean(&decode(bytes), &mut Report::default()).unwrap().text;
            assert_eq!(cleaned, "<robot name=\"Gr\u{f6}\u{df}e\"></robot>");
        }
    }

    fn links(text: &str) -> Vec<String> {
        let cleaned = clean(text, &mut Report::default()).unwrap().text;
        let links = urdf_rs::read_from_string(&cleaned).unwrap().links;
        links.into_iter().map(|link| link.name).collect()
    }

    #[test]
    fn everything_around_the_links_is_skipped() {
        for (inside, names) in [
            ("<link g:x='1' name='&lt;&#x41;\"'/><g:link/><link name='b'/>", &["<A\"", "b"][..]),
            ("<![CDATA[<!--]]><link name='a'/><![CDATA[-->]]><?p <!-- ?><b/><?q --> ?>", &["a"]),
            ("<!-- - -- ---><link name='a'/>text<?p '?><![CDATA[<b/>]]>", &["a"]),
            ("<h:camera h:x='1'/><link name='a'/><i:j/>", &["a"]),
            ("<gazebo><xacro:grey/><a b='${c}'/></gazebo><link name='a'/>", &["a"]),
            ("<!-- <!ENTITY n 'e'> --><link name='a-b'/><![CDATA[<!ENTITY n 'e'>]]>", &["a-b"]),
            ("<![CDATA[<!--]]><link name='a-b'/><![CDATA[-->]]>", &["a-b"]),
        ] {
            let head = "\n<!-- -- <robot -->\n<?xml version='1.0' encoding='latin1'?>\n<!DOCTYPE \
                        robot [<!ELEMENT a ANY>]>\n<robot xmlns:g='g' xmlns:xacro='x'>";
            assert_eq!(links(&format!("{head}{inside}</robot>\n")), names, "{inside}");
        }
        let crowded = format!("<!-- {} -->", "= xmlns ".repeat(2 * MAX_ATTRIBUTES));
        assert!(links(&format!("<robot>{crowded}</robot>")).is_empty());
    }
}
