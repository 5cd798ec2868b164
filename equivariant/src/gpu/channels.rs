//! Where the numbers of a field lie among the channels of a pixel, and the text that reads them.

use symmetry::FieldType;

use crate::gpu::step::{Slot, Step};

/// Names of a field's numbers in WGSL.
const LANES: [&[&str]; 3] = [&[""], &[".x", ".y"], &[".x", ".y", ".z", ".w"]];

/// Fields among the channels of a pixel: number a of field f is channel `starts[a] + f`, if f is
/// below `counts[a]`, and zero otherwise.
#[derive(Clone, Debug)]
pub(crate) struct Channels {
    /// Channels of a pixel.
    dim: usize,
    starts: Vec<usize>,
    counts: Vec<usize>,
}

impl Channels {
    /// The channels of a type: a number for each irrep of its group. Irreps that have fewer
    /// channels than others are filled up with zeros.
    pub fn of(fields: FieldType) -> Channels {
        let irreps = fields.group().irreps();
        Channels {
            dim: fields.dim(),
            starts: irreps.iter().map(|&a| fields.range(a).start).collect(),
            counts: irreps.iter().map(|&a| fields.multiplicity(a)).collect(),
        }
    }

    /// `dim` fields of one number.
    pub fn single(dim: usize) -> Channels {
        Channels::regular(1, dim)
    }

    /// `fields` fields of this many numbers.
    pub fn regular(order: usize, fields: usize) -> Channels {
        Channels {
            dim: order * fields,
            starts: (0..order).map(|a| a * fields).collect(),
            counts: vec![fields; order],
        }
    }

    /// The same fields in pixels of `dim` channels, where number a starts at `starts[a]`.
    pub fn within(mut self, dim: usize, starts: Vec<usize>) -> Channels {
        self.dim = dim;
        self.starts = starts;
        self
    }

    /// The same fields where the first ones of another type are.
    pub fn at_start_of(&self, sum: &Channels) -> Channels {
        self.clone().within(sum.dim, sum.starts.clone())
    }

    /// The same fields where the last ones of another type are.
    pub fn at_end_of(&self, sum: &Channels) -> Channels {
        let ends = sum.starts.iter().zip(&sum.counts).map(|(start, count)| start + count);
        let starts = ends.zip(&self.counts).map(|(end, count)| end - count);
        self.clone().within(sum.dim, starts.collect())
    }

    /// The number of fields, of which some may lack numbers.
    pub fn fields(&self) -> usize {
        self.counts.iter().copied().max().unwrap_or(0)
    }

    /// The number of irreps.
    pub fn order(&self) -> usize {
        self.counts.len()
    }

    /// Adds a map that is read: `load_NAME(pixel, field)`.
    pub fn read(&self, step: Step, name: &str, slot: Slot) -> Step {
        let step = step.read(name, "f32", slot);
        self.loader(step, name, name)
    }

    /// Adds `load_NAME(pixel, field)` for a buffer that is there already.
    pub fn loader(&self, step: Step, buffer: &str, name: &str) -> Step {
        let body = self.each(|lane, at| format!("v{lane} = {buffer}[{at}];"));
        let head = format!("fn load_{name}(pixel: u32, field: u32) -> Field {{ var v = Field();");
        step.text(&format!("{head} {body} return v; }}"))
    }

    /// Adds a map that is written: `store_NAME(pixel, field, v)`.
    pub fn write(&self, step: Step, name: &str, slot: Slot) -> Step {
        let step = step.write(name, "f32", slot);
        self.storer(step, name, name)
    }

    /// Adds `store_NAME(pixel, field, v)` for a buffer that is there already.
    pub fn storer(&self, step: Step, buffer: &str, name: &str) -> Step {
        let body = self.each(|lane, at| format!("{buffer}[{at}] = v{lane};"));
        let head = format!("fn store_{name}(pixel: u32, field: u32, v: Field) {{");
        step.text(&format!("{head} {body} }}"))
    }

    /// A statement for each number that a field can have.
    fn each(&self, statement: impl Fn(&str, String) -> String) -> String {
        let lanes = LANES[self.order().ilog2() as usize].iter().zip(&self.starts);
        let lanes = lanes.zip(&self.counts).filter(|(_, count)| **count > 0);
        let statements = lanes.map(|((lane, start), &count)| {
            let at = format!("pixel * {}u + {start}u + field", self.dim);
            match count < self.fields() {
                true => format!("if field < {count}u {{ {} }} ", statement(lane, at)),
                false => statement(lane, at) + " ",
            }
        });
        statements.collect()
    }
}
