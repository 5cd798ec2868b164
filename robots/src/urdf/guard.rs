//! What is refused before any parser sees it: parsers of XML recurse, and take long over long
//! files.

use crate::error::DescriptionError;

/// Most bytes of a URDF.
pub const MAX_BYTES: usize = 2 << 20;
/// Most levels of elements inside elements.
pub const MAX_DEPTH: usize = 64;

/// Refuses a text that is too long or too deep.
pub(super) fn check(text: &str) -> Result<(), DescriptionError> {
    if text.len() > MAX_BYTES {
        return Err(DescriptionError::TooLong { limit: MAX_BYTES });
    }
    if depth(text) > MAX_DEPTH {
        return Err(DescriptionError::TooDeep { limit: MAX_DEPTH });
    }
    Ok(())
}

/// Levels of elements inside elements. Text that is not XML has some depth, too.
fn depth(text: &str) -> usize {
    let (mut level, mut deepest) = (0_usize, 0);
    let mut rest = text;
    while let Some((_, tag)) = rest.split_once('<') {
        rest = after(tag);
        let inside = &tag[..tag.len() - rest.len()];
        if inside.starts_with('/') {
            level = level.saturating_sub(1);
        } else if !inside.starts_with(['!', '?']) && !inside.ends_with("/>") {
            level += 1;
            deepest = deepest.max(level);
        }
    }
    deepest
}

/// What follows a tag or a comment, of which the opening bracket is gone.
fn after(tag: &str) -> &str {
    let end = |end: &str| tag.split_once(end).map_or("", |(_, rest)| rest);
    if tag.starts_with("!--") {
        return end("-->");
    }
    if tag.starts_with("![CDATA[") {
        return end("]]>");
    }
    let mut quote = None;
    for (index, byte) in tag.bytes().enumerate() {
        match (quote, byte) {
            (None, b'>') => return &tag[index + 1..],
            (None, b'"' | b'\'') => quote = Some(byte),
            (Some(open), _) if open == byte => quote = None,
            _ => {}
        }
    }
    ""
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn levels_are_counted_past_comments_and_attributes() {
        let text = r#"<?xml version="1.0"?><!-- <a><b><c> --><a x="/>" y='">'><b/><c></c>
            <![CDATA[<d><e><f>]]><d><e/></d></a>"#;
        assert_eq!(depth(text), 2);
        assert_eq!(depth(""), 0);
        assert_eq!(depth("</a></a><a>"), 1);
        assert_eq!(depth("<a <b <c"), 1);
        assert_eq!(depth(&"<a>".repeat(100)), 100);
    }
}
