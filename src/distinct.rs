//! Lists that name each thing once.

/// Each value once, in the order in which they first appear.
pub(crate) fn distinct<T: PartialEq>(values: impl IntoIterator<Item = T>) -> Vec<T> {
    let mut once = Vec::new();
    for value in values {
        if !once.contains(&value) {
            once.push(value);
        }
    }
    once
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_comes_again_later_is_named_once() {
        assert_eq!(distinct([3, 1, 1, 3, 2]), [3, 1, 2]);
    }
}
