//! The notation of field types as a language: what is printed is parsed, and nothing panics.

#![allow(clippy::unwrap_used, reason = "test code")]

use proptest::prelude::*;
use symmetry::{FieldType, Group, ParseFieldTypeError};

fn group() -> impl Strategy<Value = Group> {
    prop::sample::select(Group::ALL.to_vec())
}

/// Small multiplicities, which make regular fields, and the largest.
fn multiplicities() -> impl Strategy<Value = [usize; 4]> {
    let largest = FieldType::MAX_DIM / 4;
    let all = prop::array::uniform4(prop_oneof![0..5_usize, 0..=largest, Just(largest)]);
    // of one irrep there can be more than of four
    let one = (0..4_usize, 0..=FieldType::MAX_DIM).prop_map(|(irrep, count)| {
        let mut multiplicities = [0; 4];
        multiplicities[irrep] = count;
        multiplicities
    });
    prop_oneof![all, one]
}

/// Texts that are almost notation.
fn almost() -> impl Strategy<Value = String> {
    let count = prop_oneof![
        "[0-9]{1,3}",
        "[0-9]{19,21}",
        Just(usize::MAX.to_string()),
        Just(FieldType::MAX_DIM.to_string()),
        "[-+ ]?[0-9]?",
    ];
    let name = prop::sample::select(vec!["reg", "1", "x", "y", "xy", "z", ""]);
    let term = (count, name).prop_map(|(count, name)| format!("{count} {name}"));
    let sum = prop::collection::vec(term, 0..5).prop_map(|terms| terms.join("+"));
    let group = prop::sample::select(vec!["", "C1:", "D1x: ", "D1y:", "C2: ", "D2:", "D4:", ":"]);
    (group, sum).prop_map(|(group, sum)| format!("{group}{sum}"))
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2000))]

    #[test]
    fn what_is_printed_is_parsed(group in group(), multiplicities in multiplicities()) {
        let field = FieldType::new(group, multiplicities);
        prop_assert_eq!(field.to_string().parse::<FieldType>(), Ok(field));
    }

    #[test]
    fn regular_fields_are_those_of_the_regular_type(
        group in group(),
        multiplicities in multiplicities(),
    ) {
        let field = FieldType::new(group, multiplicities);
        let mut irreps = group.irreps().iter().map(|&irrep| field.multiplicity(irrep));
        let first = irreps.next().unwrap();
        let expected = irreps.all(|count| count == first).then_some(first);
        prop_assert_eq!(field.num_regular_fields(), expected);
        if let Some(fields) = expected {
            prop_assert_eq!(group.regular_type(fields), field);
        }
    }

    #[test]
    fn no_text_panics_and_what_is_parsed_is_printed(
        text in prop_oneof![any::<String>(), almost()],
    ) {
        if let Ok(field) = text.parse::<FieldType>() {
            prop_assert!(field.dim() <= FieldType::MAX_DIM);
            let _ = field.num_regular_fields();
            prop_assert_eq!(field.to_string().parse::<FieldType>(), Ok(field));
        }
    }
}

#[test]
fn sums_that_overflow_are_refused_with_their_term() {
    let max = FieldType::MAX_DIM;
    let cases = [
        (format!("{} x + 1 x", usize::MAX), format!("{} x", usize::MAX)),
        ("99999999999999999999999 x".into(), "99999999999999999999999 x".into()),
        (format!("{max} x + 1 y"), "1 y".into()),
        (format!("{} reg", max / 4 + 1), format!("{} reg", max / 4 + 1)),
        (format!("C2: {} reg + 1 1", max / 2), "1 1".into()),
    ];
    for (text, term) in cases {
        let error = text.parse::<FieldType>().unwrap_err();
        assert_eq!(error, ParseFieldTypeError::TooManyChannels { term }, "{text}");
        assert!(error.to_string().contains("at most 16777216 channels"), "{error}");
    }
    let largest: FieldType = format!("{} reg", max / 4).parse().unwrap();
    assert_eq!(largest.dim(), max);
}

#[test]
#[should_panic(expected = "at most 2^24 channels")]
fn sums_of_types_that_overflow_are_refused() {
    let _ = Group::D2.trivial_type(FieldType::MAX_DIM) + Group::D2.trivial_type(1);
}

#[test]
#[should_panic(expected = "at most 2^24 channels")]
fn restrictions_cannot_hide_an_overflow() {
    FieldType::new(Group::C1, [usize::MAX, 1, 0, 0]);
}
