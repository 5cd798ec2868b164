//! A kernel with the buffers that it runs on.

/// A buffer of a plan.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Slot(pub(crate) usize);

/// How many groups of threads a kernel needs for N samples: `times` for each tile of `each` N +
/// `fixed` units.
#[derive(Clone, Copy, Debug)]
pub struct Work {
    each: usize,
    fixed: usize,
    tile: usize,
    times: usize,
}

/// Threads of a group; `common.wgsl` says the same.
pub(crate) const THREADS: usize = 64;

impl Work {
    /// This many threads for each sample.
    pub fn threads(each: usize) -> Work {
        Work { each, fixed: 0, tile: THREADS, times: 1 }
    }

    /// This many threads, whatever the number of samples.
    pub fn fixed_threads(fixed: usize) -> Work {
        Work { each: 0, fixed, tile: THREADS, times: 1 }
    }

    /// This many groups for each sample.
    pub fn groups(each: usize) -> Work {
        Work { each, fixed: 0, tile: 1, times: 1 }
    }

    /// This many groups, whatever the number of samples.
    pub fn fixed_groups(fixed: usize) -> Work {
        Work { each: 0, fixed, tile: 1, times: 1 }
    }

    /// `times` groups for each tile of rows.
    pub(crate) fn tiles(rows: Rows, tile: usize, times: usize) -> Work {
        let (each, fixed) = match rows {
            Rows::Each(each) => (each, 0),
            Rows::Fixed(fixed) => (0, fixed),
        };
        Work { each, fixed, tile, times }
    }

    /// The number of groups.
    pub(crate) fn count(self, samples: usize) -> usize {
        (self.each * samples + self.fixed).div_ceil(self.tile) * self.times
    }
}

/// A number of rows: so many for each sample, or for the whole batch.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Rows {
    Each(usize),
    Fixed(usize),
}

impl Rows {
    /// The number as an expression of WGSL.
    pub fn expression(self) -> String {
        match self {
            Rows::Each(each) => format!("batch.samples * {each}u"),
            Rows::Fixed(fixed) => format!("{fixed}u"),
        }
    }
}

/// How a kernel combines the values of the threads of a group.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Combine {
    Sum,
    Largest,
}

/// A function that combines values of type `element`.
#[derive(Clone, Copy, Debug)]
struct Reduction {
    name: &'static str,
    element: &'static str,
    combine: Combine,
}

impl Reduction {
    fn text(self, subgroups: bool) -> String {
        let text = match subgroups {
            true => include_str!("wgsl/reduce_in_subgroups.wgsl"),
            false => include_str!("wgsl/reduce.wgsl"),
        };
        let (combined, of_subgroup) = match self.combine {
            Combine::Sum => ("a + b", "subgroupAdd"),
            Combine::Largest => ("max(a, b)", "subgroupMax"),
        };
        let text = text.replace("NAME", self.name);
        let text = text.replace("TYPE", self.element);
        let text = text.replace("COMBINED", combined);
        text.replace("OF_SUBGROUP", of_subgroup)
    }
}

/// A dispatch: the text of its kernel, its buffers in the order of their bindings, and its size.
#[derive(Clone, Debug)]
pub struct Step {
    pub(crate) label: &'static str,
    source: String,
    reductions: Vec<Reduction>,
    /// Buffers, and whether the kernel writes them.
    pub(crate) buffers: Vec<(Slot, bool)>,
    pub(crate) work: Work,
}

impl Step {
    /// A kernel on fields of this order, 1, 2 or 4.
    ///
    /// Its text begins with `wgsl/common.wgsl`, which has the batch and what follows from a thread's
    /// `Place`, and with `wgsl/group_1.wgsl` or another of these, which has the arithmetic of a
    /// field. A kernel's `main` takes a `Place` (`wgsl/place.wgsl`), which says by `thread` which
    /// of the group's threads it is.
    pub fn new(label: &'static str, order: usize, work: Work) -> Step {
        let group = match order {
            1 => include_str!("wgsl/group_1.wgsl"),
            2 => include_str!("wgsl/group_2.wgsl"),
            _ => include_str!("wgsl/group_4.wgsl"),
        };
        Step {
            label,
            source: [include_str!("wgsl/common.wgsl"), group].concat(),
            reductions: Vec::new(),
            buffers: Vec::new(),
            work,
        }
    }

    /// Adds text of WGSL.
    pub fn text(mut self, text: &str) -> Step {
        self.source.push_str(text);
        self.source.push('\n');
        self
    }

    /// Adds constants of type u32.
    pub fn constants<const N: usize>(self, constants: [(&str, usize); N]) -> Step {
        constants
            .into_iter()
            .fold(self, |step, (name, value)| step.text(&format!("const {name} = {value}u;")))
    }

    /// Adds a constant of type f32, the nearest finite one.
    pub fn number(self, name: &str, value: f64) -> Step {
        let value = value.clamp(f64::from(f32::MIN), f64::from(f32::MAX));
        // in decimal, with a point or an exponent: as short as it can be read back
        self.text(&format!("const {name}: f32 = {:?};", value as f32))
    }

    /// Adds the sum over the threads of a group: `summed(value, place)`, where `place` is that of
    /// `main`. All threads of the group must call it.
    pub fn sums(self) -> Step {
        self.reduction("summed", "f32", Combine::Sum)
    }

    /// Adds `name(value, place)`, which combines the values of the threads of a group.
    pub(crate) fn reduction(
        mut self,
        name: &'static str,
        element: &'static str,
        combine: Combine,
    ) -> Step {
        self.reductions.push(Reduction { name, element, combine });
        self
    }

    /// The whole text of the kernel, which combines values by operations on subgroups or without.
    pub(crate) fn source(&self, subgroups: bool) -> String {
        let subgroups = subgroups && !self.reductions.is_empty();
        let place = match subgroups {
            true => include_str!("wgsl/place_in_subgroups.wgsl"),
            false => include_str!("wgsl/place.wgsl"),
        };
        let mut source = [&self.source, place].concat();
        for reduction in &self.reductions {
            source.push_str(&reduction.text(subgroups));
        }
        source
    }

    /// Adds a buffer that is read, as an array of `element`.
    pub fn read(self, name: &str, element: &str, slot: Slot) -> Step {
        self.buffer((name, "read"), element, (slot, false))
    }

    /// Adds a buffer that is written, as an array of `element`.
    pub fn write(self, name: &str, element: &str, slot: Slot) -> Step {
        self.buffer((name, "read_write"), element, (slot, true))
    }

    fn buffer(mut self, (name, access): (&str, &str), element: &str, slot: (Slot, bool)) -> Step {
        self.buffers.push(slot);
        let binding = self.buffers.len();
        self.text(&format!(
            "@group(0) @binding({binding}) var<storage, {access}> {name}: array<{element}>;"
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_kernels_that_combine_values_have_operations_on_subgroups() {
        let step = || Step::new("some", 4, Work::fixed_groups(1));
        let has = |step: Step, subgroups| step.source(subgroups).contains("subgroup");
        assert!(has(step().sums(), true) && !has(step().sums(), false));
        assert!(!has(step(), true) && !has(step(), false));
    }
}
