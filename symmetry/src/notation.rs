//! The notation of field types: `8 reg + 2 x`, `C2: 8 reg + 2 x`.

use std::error::Error;
use std::fmt;
use std::num::{IntErrorKind, ParseIntError};
use std::str::FromStr;

use crate::field_type::FieldType;
use crate::group::{Group, ParseGroupError};
use crate::irrep::Irrep;

impl fmt::Display for FieldType {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (group, name) = (self.group(), |a: Irrep| a.to_string());
        let irreps = group.irreps();
        // in C1 the regular field is the trivial one, and the shorter name is the clearer one
        let regular = match group {
            Group::C1 => 0,
            _ => irreps.iter().map(|&a| self.multiplicity(a)).min().unwrap_or(0),
        };
        let rest = irreps.iter().map(|&a| (self.multiplicity(a) - regular, name(a)));
        let terms: Vec<String> = [(regular, "reg".to_owned())]
            .into_iter()
            .chain(rest)
            .filter(|(count, _)| *count > 0)
            .map(|(count, irrep)| format!("{count} {irrep}"))
            .collect();
        let sum = if terms.is_empty() { "0".to_owned() } else { terms.join(" + ") };
        // D2 is the usual group of a table, so its name is left out
        match group {
            Group::D2 => f.pad(&sum),
            _ => f.pad(&format!("{group}: {sum}")),
        }
    }
}

/// Error of parsing a field type; each variant holds the offending part of the text.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum ParseFieldTypeError {
    /// Text before the colon that names no symmetry group.
    Group(ParseGroupError),
    /// Term that does not consist of a count and a representation, as `2 x` does.
    Term(String),
    /// Term that brings the field type above [`FieldType::MAX_DIM`] channels.
    TooManyChannels {
        /// Term with which the field type exceeds the maximum.
        term: String,
    },
    /// Representation that the symmetry group does not have.
    Representation {
        /// Symmetry group of the field type.
        group: Group,
        /// Name of the representation, as found in the text.
        name: String,
    },
}

impl fmt::Display for ParseFieldTypeError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Group(source) => source.fmt(f),
            Self::Term(term) => write!(
                f,
                "got the term `{term}`, expected a count and a representation such as `8 reg`; \
                 join terms with `+`"
            ),
            Self::TooManyChannels { term } => write!(
                f,
                "got the term `{term}`, but a field type has at most {} channels in all",
                FieldType::MAX_DIM
            ),
            Self::Representation { group, name } => {
                let irreps = group.irreps().iter().map(|a| format!(", `{a}`"));
                write!(
                    f,
                    "got the representation `{name}`, expected one of `reg`{} for {group}",
                    irreps.collect::<String>()
                )
            }
        }
    }
}

impl Error for ParseFieldTypeError {}

impl FromStr for FieldType {
    type Err = ParseFieldTypeError;

    /// Parses a field type: terms `<count> <representation>` joined by `+`, after the group and a
    /// colon unless it is D2; `0` is the empty type.
    fn from_str(text: &str) -> Result<FieldType, ParseFieldTypeError> {
        let (group, sum) = match text.split_once(':') {
            Some((group, sum)) => (group.trim().parse().map_err(ParseFieldTypeError::Group)?, sum),
            None => (Group::D2, text),
        };
        // the empty type has no terms, so it needs a notation of its own
        if sum.trim() == "0" {
            return Ok(group.trivial_type(0));
        }
        sum.split('+').try_fold(group.trivial_type(0), |sum, term| {
            let term = term.trim();
            let (count, field) = parse_term(group, term)?;
            let larger = count.and_then(|count| sum.plus_copies_of(field, count));
            larger.ok_or_else(|| ParseFieldTypeError::TooManyChannels { term: term.into() })
        })
    }
}

/// Parses a term of a field type, such as `2 x`, into the count and the type of a single
/// representation. The count is `None` if it is too large for a `usize`.
fn parse_term(group: Group, term: &str) -> Result<(Option<usize>, FieldType), ParseFieldTypeError> {
    let malformed = || ParseFieldTypeError::Term(term.to_owned());
    let (count, name) = term.split_once(' ').ok_or_else(malformed)?;
    let count = match count.parse() {
        Ok(count) => Some(count),
        // reported as too many channels, not as a malformed term
        Err(error) if is_overflow(&error) => None,
        Err(_) => return Err(malformed()),
    };
    Ok((count, parse_representation(group, name.trim())?))
}

fn is_overflow(error: &ParseIntError) -> bool {
    *error.kind() == IntErrorKind::PosOverflow
}

fn parse_representation(group: Group, name: &str) -> Result<FieldType, ParseFieldTypeError> {
    if name == "reg" {
        return Ok(group.regular_type(1));
    }
    let mut irreps = group.irreps().iter();
    let irrep = irreps
        .find(|irrep| irrep.to_string() == name)
        .ok_or_else(|| ParseFieldTypeError::Representation { group, name: name.to_owned() })?;
    Ok(FieldType::from_irreps(group, &[*irrep]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn types_print_as_the_papers_write_them() {
        let print = |group, multiplicities| FieldType::new(group, multiplicities).to_string();
        assert_eq!(print(Group::D2, [8, 10, 8, 8]), "8 reg + 2 x");
        assert_eq!(print(Group::D2, [6, 0, 0, 0]), "6 1");
        assert_eq!(print(Group::C2, [8, 10, 0, 0]), "C2: 8 reg + 2 x");
        assert_eq!(print(Group::D1y, [1, 0, 3, 0]), "D1y: 1 reg + 2 y");
        assert_eq!(print(Group::C1, [3, 0, 0, 0]), "C1: 3 1");
        assert_eq!(print(Group::C1, [0; 4]), "C1: 0");
    }

    #[test]
    fn wrong_notation_is_refused_with_its_part() {
        let parse = |text: &str| text.parse::<FieldType>().unwrap_err();
        assert_eq!(parse("8"), ParseFieldTypeError::Term("8".into()));
        assert_eq!(parse("2 x + "), ParseFieldTypeError::Term("".into()));
        assert_eq!(parse("-1 x"), ParseFieldTypeError::Term("-1 x".into()));
        let message = |text| parse(text).to_string();
        assert!(message("2 x + 3 z").contains("got the representation `z`"));
        assert!(message("C2: 1 y").contains("`y`, expected one of `reg`, `1`, `x` for C2"));
        assert!(message("C3: 1 x").contains("got the group `C3`"));
    }
}
