//! Which renderer is meant.

use std::fmt;
use std::sync::atomic::{AtomicU64, Ordering};

/// Tells the renderers of a process apart. It prints as `renderer 3 (64 x 48)`, width first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct RendererId {
    number: u64,
    width: usize,
    height: usize,
}

impl RendererId {
    /// An id that no other renderer has, of images of this size in pixels.
    pub(crate) fn next(width: usize, height: usize) -> Self {
        static NEXT: AtomicU64 = AtomicU64::new(0);
        Self {
            number: NEXT.fetch_add(1, Ordering::Relaxed),
            width,
            height,
        }
    }
}

impl fmt::Display for RendererId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (width, height) = (self.width, self.height);
        write!(f, "renderer {} ({width} x {height})", self.number)
    }
}
