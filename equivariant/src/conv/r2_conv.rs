//! Steerable convolutions: geometry and layout of the parameters.

use symmetry::{FieldType, Irrep};

use crate::conv::weights::WeightLayout;
use crate::error::LayerError;
use crate::shape::{Shape, checked_product};
use crate::simd::lanes::InstructionSet;
use crate::simd::patches::PatchGeometry;
use crate::steerable::dense::OrdinaryConv;
use crate::steerable::irrep_weights::IrrepWeights;
use crate::steerable::taps::TapBasis;
use crate::steerable::windows::WindowGrid;
use crate::window::SlidingWindow;

/// Maximum number of output pixels of the images that are brought into the blocked
/// layout together; a larger image is alone.
const PIXELS_CONVERTED_AT_ONCE: usize = 64;

/// Steerable convolution: it commutes with the symmetry group of its field types, and has a bias on
/// the trivial irrep.
///
/// The kernel obeys k(g t) = rho_out(g) k(t) rho_in(g)^-1 (Cohen and Welling, "Steerable CNNs",
/// ICLR 2017). Between irreps a and b that is w(g t) = a(g) b(g) w(t): the signs of the irrep a b.
/// Patches are therefore folded by parity (even and odd along each axis for D2), and output irrep b
/// is one product of its folded columns with a matrix of parameters `[out multiplicity of b,
/// columns]`. The parameters of all irreps are interleaved in the order in which the kernels read
/// them, `[folded tap and input channel, output field, irrep]`, and the bias follows;
/// [`as_ordinary_conv`](R2Conv::as_ordinary_conv) maps them to an ordinary kernel. The parameters
/// span every steerable kernel on the grid. Types of C1 give an ordinary convolution whose
/// parameters are the kernel `[size, size, C_in, C_out]`.
#[derive(Clone, Debug)]
pub struct R2Conv {
    pub(crate) taps: TapBasis,
    pub(crate) patches: PatchGeometry,
    pub(crate) irrep_weights: IrrepWeights,
    pub(crate) weights: WeightLayout,
    pub(crate) out_shape: Shape,
    /// Widest instruction set that single precision may use; a CPU without it uses a narrower one.
    pub(crate) widest_instruction_set: InstructionSet,
}

impl R2Conv {
    /// Creates a convolution of feature maps of `[height, width]` pixels.
    ///
    /// # Errors
    /// When the groups of the types differ, a map is empty, the windows do not sit symmetrically
    /// (see [`SlidingWindow`]) or none fits.
    pub fn new(
        in_type: FieldType,
        out_type: FieldType,
        kernel: SlidingWindow,
        size: [usize; 2],
    ) -> Result<R2Conv, LayerError> {
        let layer = "R2Conv";
        let image = Shape::image(size[0], size[1], in_type);
        LayerError::check_groups(layer, in_type, out_type)?;
        let windows = WindowGrid::new(layer, out_type.group(), kernel, size)?;
        let out = windows.out_shape(out_type);
        LayerError::check_feature_map_size(layer, image, kernel.padding)?;
        LayerError::check_feature_map_size(layer, out, 0)?;
        // `dense` builds this kernel, so its size must be within the limit as well
        let dense = [kernel.size, kernel.size, image.fields.dim(), out_type.dim()];
        checked_product(dense).ok_or(LayerError::TooManyValues { layer, what: "a kernel" })?;
        let taps = TapBasis::new(image.fields, kernel.size);
        let patches = PatchGeometry::new(&taps, image, kernel, windows.out_size);
        let irrep_weights =
            IrrepWeights::new(Irrep::ALL.map(|b| taps.num_weight_columns(b)), out_type);
        Ok(R2Conv {
            weights: WeightLayout::new(&taps, &patches, &irrep_weights, out_type),
            taps,
            patches,
            irrep_weights,
            out_shape: out,
            // an upper bound: `run_f32` falls back to what the CPU has
            widest_instruction_set: InstructionSet::Avx512,
        })
    }

    /// Creates a convolution that flattens a square feature map to a vector: its window is the
    /// whole map.
    ///
    /// # Errors
    /// When the groups of the types differ or the map is not square.
    pub fn flattening(shape: Shape, out_type: FieldType) -> Result<R2Conv, LayerError> {
        let Shape { height, width, .. } = shape;
        if height != width {
            return Err(LayerError::InvalidSetting {
                layer: "R2Conv::flattening",
                setting: "map",
                got: format!("of {height} x {width} pixels"),
                expected: "a square one",
            });
        }
        let kernel = SlidingWindow::new(height, 1, 0);
        R2Conv::new(shape.fields, out_type, kernel, [height, width])
    }

    /// Limits the layer to instruction sets up to `widest`, for comparisons. AVX2 and AVX-512 give
    /// the same bits; portable code gives others and always runs double precision.
    pub fn limit_instruction_set(mut self, widest: InstructionSet) -> R2Conv {
        self.widest_instruction_set = widest;
        self
    }

    /// Returns an ordinary convolution equal to the layer, for checks and export.
    pub fn as_ordinary_conv(&self) -> OrdinaryConv<'_> {
        OrdinaryConv {
            layer_name: "R2Conv",
            taps: self.taps.clone(),
            irrep_weights: &self.irrep_weights,
            param_indices: Some(&self.weights.param_indices),
            window: self.patches.window,
            in_shape: self.image_shape(),
            out_shape: self.out_shape,
        }
    }

    /// Returns the shape of one input sample.
    pub(crate) fn image_shape(&self) -> Shape {
        self.patches.image_shape
    }

    /// Returns the number of images that a pass over `samples` samples brings into the
    /// blocked layout together.
    pub(crate) fn num_images_converted_at_once(&self, samples: usize) -> usize {
        let images = PIXELS_CONVERTED_AT_ONCE / self.out_shape.num_pixels();
        images.clamp(1, samples.max(1))
    }
}
