//! Escaping of text from files and folders, for safe display in terminals.

use std::fmt::Display;

/// Largest number of characters of a message that is printed in full.
const LONGEST_MESSAGE: usize = 2000;

/// Escapes every control character (line ends included) and every character that changes the
/// direction of writing as a code like `\u001b`, so that the text cannot move the cursor or hide
/// anything. The codes are JSON's, so that escaped JSON strings keep their meaning.
pub fn escape_unprintable(text: &str) -> String {
    escaped_but(text, |_| false)
}

/// Escapes the characters of a text that [`escape_unprintable`] escapes, but for line feeds and
/// tabs, which stay.
pub fn escape_unprintable_lines(text: &str) -> String {
    escaped_but(text, |character| matches!(character, '\n' | '\t'))
}

/// Returns a message for a terminal or a log: control characters are escaped, and the middle of a
/// message of more than 2000 characters is left out.
pub fn printable_message(message: &impl Display) -> String {
    let message = message.to_string();
    let length = message.chars().count();
    if length <= LONGEST_MESSAGE {
        return escape_unprintable_lines(&message);
    }
    let left_out = length - LONGEST_MESSAGE;
    let start: String = message.chars().take(LONGEST_MESSAGE / 2).collect();
    let end: String = message.chars().skip(LONGEST_MESSAGE / 2 + left_out).collect();
    escape_unprintable_lines(&format!("{start} ({left_out} characters left out) {end}"))
}

fn escaped_but(text: &str, stays: fn(char) -> bool) -> String {
    let mut printable = String::with_capacity(text.len());
    for character in text.chars() {
        if is_control(character) && !stays(character) {
            printable += &format!("\\u{:04x}", u32::from(character));
        } else {
            printable.push(character);
        }
    }
    printable
}

/// Returns `true` for characters that a terminal or a web page interprets instead of showing.
fn is_control(character: char) -> bool {
    // Unicode's marks, embeddings, overrides and isolates of bidirectional text
    let changes_direction = matches!(
        character,
        '\u{61c}' | '\u{200e}'..='\u{200f}' | '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}'
    );
    // separators of lines and paragraphs
    let ends_line = matches!(character, '\u{2028}'..='\u{2029}');
    character.is_control() || changes_direction || ends_line
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn long_messages_keep_their_ends() {
        let short = "no \u{1b}[2J".to_owned();
        assert_eq!(printable_message(&short), "no \\u001b[2J");
        let longest = "é".repeat(LONGEST_MESSAGE);
        assert_eq!(printable_message(&longest), longest);
        let message = printable_message(&format!("cannot {} be", "x".repeat(200_000)));
        assert!(message.starts_with("cannot x") && message.ends_with("x be"), "{message}");
        assert!(message.contains(" (198010 characters left out) "), "{message}");
        assert!(message.len() < 2100);
    }

    #[test]
    fn nothing_that_steers_a_terminal_is_left() {
        let cases = [
            ("\u{1b}]0;title\u{7}", "\\u001b]0;title\\u0007"),
            ("\u{9b}2J\u{7f}", "\\u009b2J\\u007f"),
            ("a\u{202e}b\u{2028}", "a\\u202eb\\u2028"),
            ("plate-slide é 測", "plate-slide é 測"),
        ];
        for (text, expected) in cases {
            assert_eq!(escape_unprintable(text), expected);
            assert_eq!(escape_unprintable_lines(text), expected);
        }
        assert_eq!(escape_unprintable("a\nb\tc\rd"), "a\\u000ab\\u0009c\\u000dd");
        assert_eq!(escape_unprintable_lines("a\nb\tc\rd"), "a\nb\tc\\u000dd");
        let json = escape_unprintable_lines("{\"name\":\"\u{9b}\"}");
        let value: serde_json::Value = serde_json::from_str(&json).unwrap();
        assert_eq!(value["name"], "\u{9b}");
    }
}
