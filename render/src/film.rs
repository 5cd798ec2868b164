//! A film: pictures of one size.

/// Hundredths of a second from one picture to the next: 12.5 pictures a second. A decision lasts
/// 0.125 s, so a film runs at one and a half times the speed of the table.
pub(super) const DELAY: u16 = 8;
/// How many times the last picture is shown before a film begins anew.
pub(super) const HOLD: u16 = 12;

/// Pictures of one size, one for each decision.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Film {
    /// Pixels across.
    pub width: usize,
    /// Pixels down.
    pub height: usize,
    /// Each `[height, width, 3]`, row 0 on top.
    pub frames: Vec<Vec<u8>>,
}
