//! Field types: how often each irrep occurs among the channels.

use std::error::Error;
use std::fmt;
use std::ops::{Add, Neg, Range};
use std::str::FromStr;

use crate::{D2, Irrep};

/// A representation of D2 given by its multiplicity per irrep.
///
/// Channels are irrep-major: [`range`](FieldType::range) gives the channels of an irrep.
/// Prints and parses the notation of the papers, `8 reg + 2 x`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct FieldType {
    multiplicities: [usize; 4],
}

impl FieldType {
    /// The type with these multiplicities of the irreps 1, x, y and xy.
    pub const fn new(multiplicities: [usize; 4]) -> FieldType {
        FieldType { multiplicities }
    }

    /// `fields` copies of the regular representation: every irrep `fields` times.
    pub const fn regular(fields: usize) -> FieldType {
        FieldType::new([fields; 4])
    }

    /// `channels` invariant channels.
    pub const fn trivial(channels: usize) -> FieldType {
        FieldType::new([channels, 0, 0, 0])
    }

    /// The type of a vector whose entries have these irreps, in any order.
    ///
    /// [`irrep_order`](crate::irrep_order) sorts such a vector into the layout of the type.
    pub fn from_irreps(irreps: &[Irrep]) -> FieldType {
        let mut multiplicities = [0; 4];
        for irrep in irreps {
            multiplicities[irrep.index()] += 1;
        }
        FieldType::new(multiplicities)
    }

    /// The number of channels.
    pub fn dim(&self) -> usize {
        self.multiplicities.iter().sum()
    }

    /// How many channels have this irrep.
    pub const fn multiplicity(&self, irrep: Irrep) -> usize {
        self.multiplicities[irrep.index()]
    }

    /// The channels of this irrep.
    pub fn range(&self, irrep: Irrep) -> Range<usize> {
        let start = self.multiplicities[..irrep.index()].iter().sum();
        start..start + self.multiplicity(irrep)
    }

    /// The number of regular fields, if the type consists of regular fields only.
    pub fn regular_fields(&self) -> Option<usize> {
        let [n, rest @ ..] = self.multiplicities;
        rest.iter().all(|&m| m == n).then_some(n)
    }

    /// Whether every channel is invariant.
    pub fn is_trivial(&self) -> bool {
        self.multiplicities[1..] == [0; 3]
    }

    /// Transforms a channel vector in place: channels of odd irreps change sign.
    ///
    /// # Panics
    /// When `channels` does not hold [`dim`](FieldType::dim) values.
    pub fn act<T: Copy + Neg<Output = T>>(&self, g: D2, channels: &mut [T]) {
        assert_eq!(
            channels.len(),
            self.dim(),
            "wrong number of channels for {self}"
        );
        for irrep in Irrep::ALL.into_iter().filter(|a| a.sign(g) < 0) {
            for value in &mut channels[self.range(irrep)] {
                *value = -*value;
            }
        }
    }
}

impl Add for FieldType {
    type Output = FieldType;

    /// The direct sum. Its channels are irrep-major again: a sum is not a concatenation.
    fn add(self, other: FieldType) -> FieldType {
        FieldType::new(std::array::from_fn(|a| {
            self.multiplicities[a] + other.multiplicities[a]
        }))
    }
}

impl fmt::Display for FieldType {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let regular = self.multiplicities.into_iter().min().unwrap_or(0);
        let mut terms = Vec::new();
        if regular > 0 {
            terms.push(format!("{regular} reg"));
        }
        for irrep in Irrep::ALL {
            let rest = self.multiplicity(irrep) - regular;
            if rest > 0 {
                terms.push(format!("{rest} {irrep}"));
            }
        }
        if terms.is_empty() {
            terms.push("0".to_owned());
        }
        f.pad(&terms.join(" + "))
    }
}

/// Why a text is not a field type; each variant holds the offending part.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum ParseFieldTypeError {
    /// A term is not a count and a representation.
    Term(String),
    /// A representation is none of `reg`, `1`, `x`, `y`, `xy`.
    Representation(String),
}

impl fmt::Display for ParseFieldTypeError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Term(term) => write!(
                f,
                "got the term `{term}`, expected a count and a representation such as `8 reg`; \
                 join terms with `+`"
            ),
            Self::Representation(name) => write!(
                f,
                "got the representation `{name}`, expected one of `reg`, `1`, `x`, `y`, `xy`"
            ),
        }
    }
}

impl Error for ParseFieldTypeError {}

impl FromStr for FieldType {
    type Err = ParseFieldTypeError;

    /// Parses terms `<count> <representation>` joined by `+`; `0` is the empty type.
    fn from_str(text: &str) -> Result<FieldType, ParseFieldTypeError> {
        if text.trim() == "0" {
            return Ok(FieldType::default());
        }
        text.split('+').try_fold(
            FieldType::default(),
            |sum, term| Ok(sum + parse_term(term)?),
        )
    }
}

fn parse_term(term: &str) -> Result<FieldType, ParseFieldTypeError> {
    let malformed = || ParseFieldTypeError::Term(term.trim().to_owned());
    let (count, name) = term.trim().split_once(' ').ok_or_else(malformed)?;
    let count: usize = count.parse().map_err(|_| malformed())?;
    match name.trim() {
        "reg" => Ok(FieldType::regular(count)),
        name => Irrep::ALL
            .into_iter()
            .find(|irrep| irrep.to_string() == name)
            .map(|irrep| {
                let mut multiplicities = [0; 4];
                multiplicities[irrep.index()] = count;
                FieldType::new(multiplicities)
            })
            .ok_or_else(|| ParseFieldTypeError::Representation(name.to_owned())),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_are_irrep_major_and_cover_the_channels() {
        let field = FieldType::new([2, 0, 3, 1]);
        assert_eq!(field.dim(), 6);
        let ranges = Irrep::ALL.map(|a| field.range(a));
        assert_eq!(ranges, [0..2, 2..2, 2..5, 5..6]);
    }

    #[test]
    fn regular_fields_are_recognised() {
        assert_eq!(FieldType::regular(3).regular_fields(), Some(3));
        assert_eq!(FieldType::new([3, 3, 3, 2]).regular_fields(), None);
        assert!(FieldType::trivial(6).is_trivial());
        assert!(!FieldType::regular(1).is_trivial());
    }

    #[test]
    fn the_notation_survives_a_round_trip() {
        for multiplicities in [[0; 4], [8; 4], [8, 10, 8, 8], [2, 1, 1, 0], [5, 3, 3, 4]] {
            let field = FieldType::new(multiplicities);
            assert_eq!(field.to_string().parse(), Ok(field), "{field}");
        }
        assert_eq!(FieldType::new([8, 10, 8, 8]).to_string(), "8 reg + 2 x");
        assert_eq!(FieldType::trivial(6).to_string(), "6 1");
    }

    #[test]
    fn wrong_notation_is_refused_with_its_part() {
        let parse = |text: &str| text.parse::<FieldType>().unwrap_err();
        assert_eq!(parse("8"), ParseFieldTypeError::Term("8".into()));
        assert_eq!(parse("2 x + "), ParseFieldTypeError::Term("".into()));
        assert_eq!(parse("-1 x"), ParseFieldTypeError::Term("-1 x".into()));
        let wrong = parse("2 x + 3 z");
        assert_eq!(wrong, ParseFieldTypeError::Representation("z".into()));
        assert!(wrong.to_string().contains("got the representation `z`"));
    }

    #[test]
    fn the_action_is_a_representation() {
        let field = FieldType::new([1, 2, 1, 1]);
        for g in D2::ALL {
            for h in D2::ALL {
                let mut twice = [1, 2, 3, 4, 5];
                field.act(h, &mut twice);
                field.act(g, &mut twice);
                let mut once = [1, 2, 3, 4, 5];
                field.act(g * h, &mut once);
                assert_eq!(once, twice);
            }
        }
        let mut flipped = [1, 2, 3, 4, 5];
        field.act(D2::FlipX, &mut flipped);
        assert_eq!(flipped, [1, -2, -3, 4, -5]);
    }

    #[test]
    #[should_panic(expected = "wrong number of channels for 1 reg")]
    fn acting_on_the_wrong_number_of_channels_is_refused() {
        FieldType::regular(1).act(D2::FlipX, &mut [0.0; 5]);
    }
}
