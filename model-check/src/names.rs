//! Names of left and right objects.

/// Returns `true` if two names differ only by left and right: `FL_hip` and `FR_hip`, `left_knee`
/// and `right_knee`, `lElbow` and `rElbow`.
pub(crate) fn are_mirror_names(one: &str, other: &str) -> bool {
    let [one, other] = [one, other].map(sides_shortened);
    let mut differing = one.chars().zip(other.chars()).filter(|(a, b)| a != b).peekable();
    one.chars().count() == other.chars().count()
        && differing.peek().is_some()
        && differing.all(|pair| matches!(pair, ('l', 'r') | ('r', 'l')))
}

/// Returns `true` if the first of two names that differ by left and right is that of the left side.
pub(crate) fn is_left(one: &str, other: &str) -> bool {
    let [one, other] = [one, other].map(sides_shortened);
    one.chars().zip(other.chars()).find(|(a, b)| a != b).is_some_and(|(a, _)| a == 'l')
}

fn sides_shortened(name: &str) -> String {
    name.to_lowercase().replace("left", "l").replace("right", "r")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sides_are_recognised_in_common_conventions() {
        for [left, right] in [
            ["FL_hip", "FR_hip"],
            ["LF_HAA", "RF_HAA"],
            ["rl_calf", "rr_calf"],
            ["left_hip_roll", "right_hip_roll"],
            ["LeftAnkle", "RightAnkle"],
            ["elbow-l", "elbow-r"],
            ["lthigh", "rthigh"],
        ] {
            assert!(are_mirror_names(left, right) && are_mirror_names(right, left), "{left}");
            assert!(is_left(left, right) && !is_left(right, left), "{left}");
        }
        for [one, other] in [["hip", "hip"], ["leg1", "leg2"], ["FL_hip", "RL_hip"], ["l", "ar"]] {
            assert!(!are_mirror_names(one, other), "{one} {other}");
        }
    }
}
