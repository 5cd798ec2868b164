//! A convolution as its passes see it.

use symmetry::{FieldType, Irrep};

use crate::conv::weights::Weights;
use crate::error::LayerError;
use crate::instruction_set::InstructionSet;
use crate::shape::{Shape, product};
use crate::simd::patches::Patches;
use crate::steerable::blocks::Blocks;
use crate::steerable::taps::Taps;
use crate::steerable::windows::Windows;
use crate::window::Kernel;

/// Output pixels that are worth staging several images together.
const GROUP_PIXELS: usize = 64;

/// The geometry of a steerable convolution, and where its parameters lie.
#[derive(Clone, Debug)]
pub struct Conv {
    pub(crate) taps: Taps,
    pub(crate) patches: Patches,
    pub(crate) blocks: Blocks,
    pub(crate) weights: Weights,
    pub(crate) out: Shape,
    /// What single precision runs on, if the processor has it.
    pub(crate) widest: InstructionSet,
}

impl Conv {
    /// The convolution of maps of one shape to another type.
    pub(crate) fn new(
        layer: &'static str,
        image: Shape,
        out_type: FieldType,
        kernel: Kernel,
    ) -> Result<Conv, LayerError> {
        LayerError::check_groups(layer, image.fields, out_type)?;
        let size = [image.height, image.width];
        let windows = Windows::new(layer, out_type.group(), kernel, size)?;
        let out = windows.out_shape(out_type);
        LayerError::check_map(layer, image, kernel.padding)?;
        LayerError::check_map(layer, out, 0)?;
        let dense = [kernel.size, kernel.size, image.fields.dim(), out_type.dim()];
        product(dense).ok_or(LayerError::TooLarge {
            layer,
            what: "a kernel",
        })?;
        let taps = Taps::new(image.fields, kernel.size);
        let patches = Patches::new(&taps, image, kernel, windows.out_size);
        let blocks = Blocks::new(Irrep::ALL.map(|b| taps.cols(b)), out_type);
        Ok(Conv {
            weights: Weights::new(&taps, &patches, &blocks, out_type),
            taps,
            patches,
            blocks,
            out,
            widest: InstructionSet::Avx512,
        })
    }

    /// The shape of one input sample.
    pub(crate) fn image(&self) -> Shape {
        self.patches.image()
    }

    pub(crate) fn num_params(&self) -> usize {
        self.blocks.num_params()
    }

    /// The number of samples that are staged together.
    pub(crate) fn group(&self, samples: usize) -> usize {
        let group = GROUP_PIXELS / self.out.pixels();
        group.clamp(1, samples.max(1))
    }
}
