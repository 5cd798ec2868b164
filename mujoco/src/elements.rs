//! The elements of an XML text with their attributes, as far as a well-formed text goes.
//!
//! MuJoCo's own reader refuses a text that is not well-formed, so that it does not matter what is
//! found in one here.

/// An element's start.
#[derive(Debug, PartialEq)]
pub(crate) struct Element<'a> {
    pub name: &'a str,
    /// Names and values, the latter as they stand between their quotes.
    pub attributes: Vec<(&'a str, &'a str)>,
}

/// What is no element, from its beginning after `<` to its end.
const OTHER: [[&str; 2]; 5] = [
    ["!--", "-->"],
    ["![CDATA[", "]]>"],
    ["!", ">"],
    ["?", "?>"],
    ["/", ">"],
];

/// The elements of a text, in its order.
pub(crate) fn elements(text: &str) -> impl Iterator<Item = Element<'_>> {
    let mut rest = text;
    std::iter::from_fn(move || {
        loop {
            let (_, after) = rest.split_once('<')?;
            let mut others = OTHER.into_iter();
            let other = others.find_map(|[start, end]| Some((after.strip_prefix(start)?, end)));
            let Some((inside, end)) = other else {
                let (element, after) = element(after);
                rest = after;
                return Some(element);
            };
            rest = inside.split_once(end)?.1;
        }
    })
}

/// The element whose name `text` begins with, and what follows its attributes.
fn element(text: &str) -> (Element<'_>, &str) {
    let (name, mut rest) = word(text);
    let mut attributes = Vec::new();
    while let Some((name, value, after)) = attribute(rest) {
        attributes.push((name, value));
        rest = after;
    }
    (Element { name, attributes }, rest)
}

/// Name and value of the attribute that `text` begins with, and what follows it.
fn attribute(text: &str) -> Option<(&str, &str, &str)> {
    let (name, rest) = word(text);
    let rest = rest.trim_start().strip_prefix('=')?.trim_start();
    let quote = rest.chars().next().filter(|c| matches!(c, '"' | '\''))?;
    let (value, rest) = rest[1..].split_once(quote)?;
    Some((name, value, rest))
}

/// A name, without the space before it, and what follows it.
fn word(text: &str) -> (&str, &str) {
    let text = text.trim_start();
    let end = text.find(|c: char| c.is_whitespace() || matches!(c, '=' | '/' | '>' | '<'));
    text.split_at(end.unwrap_or(text.len()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn elements_are_found_with_their_attributes() {
        let text = "<?xml version='1'?><a file = \"b.xml\">t=\"1\"<!-- <x y='z'> --><c é='1=2>' d='<'/>\n\
                    </a><![CDATA[<n/>]]>< f g=' /h '\n i=\"it's\"/> <j k=l>";
        let found: Vec<_> = elements(text).map(|e| (e.name, e.attributes)).collect();
        let expected = [
            ("a", vec![("file", "b.xml")]),
            ("c", vec![("é", "1=2>"), ("d", "<")]),
            ("f", vec![("g", " /h "), ("i", "it's")]),
            ("j", vec![]),
        ];
        assert_eq!(found, expected);
        for open in ["<!-- <a/>", "<![CDATA[<a/>", "text", ""] {
            assert_eq!(elements(open).count(), 0, "{open}");
        }
        assert_eq!(
            elements("<a b='1").next().map(|e| e.attributes.len()),
            Some(0)
        );
    }
}
