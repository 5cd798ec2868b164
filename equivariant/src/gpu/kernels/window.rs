//! Where windows lie, for kernels.

use symmetry::Group;

use crate::gpu::step::Step;
use crate::shape::Shape;
use crate::window::Kernel;

/// Adds what `window.wgsl` needs, and that.
pub(super) fn windows(step: Step, kernel: Kernel, [from, to]: [Shape; 2]) -> Step {
    let step = step.constants([
        ("SIZE", kernel.size),
        ("STRIDE", kernel.stride),
        ("PADDING", kernel.padding),
        ("HEIGHT", from.height),
        ("WIDTH", from.width),
        ("OUT_PIXELS", to.pixels()),
        ("OUT_WIDTH", to.width),
        ("FLIPS", flips(from.fields.group())),
    ]);
    step.text(include_str!("../wgsl/window.wgsl"))
}

/// What the position of an element in its group's list is multiplied with to give its bits: bit 0
/// flips x and bit 1 flips y.
fn flips(group: Group) -> usize {
    group.elements().get(1).map_or(0, |second| second.bits())
}
