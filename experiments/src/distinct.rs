//! Lists that name each thing once.

use std::collections::HashSet;
use std::hash::Hash;

/// Each value once, in the order in which they first appear.
pub fn distinct<T: PartialEq>(values: impl IntoIterator<Item = T>) -> Vec<T> {
    let mut once = Vec::new();
    for value in values {
        if !once.contains(&value) {
            once.push(value);
        }
    }
    once
}

/// Whether no value comes twice.
pub fn are_distinct<T: Eq + Hash>(mut values: impl Iterator<Item = T>) -> bool {
    let mut known = HashSet::new();
    values.all(|value| known.insert(value))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_comes_again_later_is_named_once() {
        assert_eq!(distinct([3, 1, 1, 3, 2]), [3, 1, 2]);
    }

    #[test]
    fn what_comes_twice_is_seen() {
        assert!(are_distinct([3, 1, 2].iter()));
        assert!(!are_distinct([3, 1, 3].iter()));
    }
}
