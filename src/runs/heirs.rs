//! Who acts for whom since policies were merged.

/// The policy that acts for the group of `policy`: its heir, or the heir's heir, or itself. `heirs`
/// has one item a policy, or fewer.
pub(crate) fn acting(heirs: &[Option<usize>], policy: usize) -> usize {
    let heir = |&policy: &usize| heirs.get(policy).copied().flatten();
    let line = std::iter::successors(Some(policy), heir);
    // no line is longer, unless it is a circle
    line.take(1 + heirs.len()).last().unwrap_or(policy)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn heirs_are_followed_to_one_that_acts() {
        let heirs = [Some(2), None, Some(1)];
        assert_eq!(
            [0, 1, 2, 3].map(|policy| acting(&heirs, policy)),
            [1, 1, 1, 3]
        );
        assert_eq!(acting(&[], 4), 4);
        assert!(acting(&[Some(1), Some(0)], 0) < 2, "a circle ends");
    }
}
