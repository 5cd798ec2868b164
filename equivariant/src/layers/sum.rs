//! Sums of branches, such as residual connections.

use std::fmt;
use std::ops::Range;

use rand::Rng;
use symmetry::{FieldType, Group};

use crate::error::LayerError;
use crate::layers::check::TestLayer;
use crate::layers::layer::{Layer, LayerSignature, Scalar, hash_of};
use crate::layers::linear::Linear;
use crate::layers::max_pool::MaxPool;
use crate::layers::r2_conv::R2Conv;
use crate::layers::relu::Relu;
use crate::layers::sequential::{Sequential, param_ranges};
use crate::scratch::{BackwardArgs, round_up_to_cache_line, take_front_padded};
use crate::shape::Shape;
use crate::window::SlidingWindow;

/// Layer that adds the outputs of several layers on one input: f(x) + g(x) + ..., or x + f(x).
///
/// Its parameters are those of its branches in order. The residual connection x + f(x) is that of
/// He et al., "Deep residual learning", CVPR 2016, equation 1. Initial weights of every branch have
/// the gain over the square root of the number of terms, x included, so that the sum has the second
/// moment of a single branch.
pub struct BranchSum<T> {
    branches: Vec<Box<dyn Layer<T>>>,
    params: Vec<Range<usize>>,
    /// `true` if the input itself is a term of the sum.
    residual: bool,
    scratch_key: u64,
}

impl<T: Scalar> BranchSum<T> {
    /// Creates a layer whose output is the sum of the outputs of `branches`.
    ///
    /// # Errors
    /// When `branches` is empty, or they do not map the same shape to the same shape.
    pub fn new(branches: Vec<Box<dyn Layer<T>>>) -> Result<BranchSum<T>, LayerError> {
        BranchSum::of(branches, false)
    }

    /// Creates a residual layer, the sum of its input and of the output of `branch`.
    ///
    /// # Errors
    /// When the layer's output has another shape than its input.
    pub fn residual(branch: Box<dyn Layer<T>>) -> Result<BranchSum<T>, LayerError> {
        BranchSum::of(vec![branch], true)
    }

    fn of(branches: Vec<Box<dyn Layer<T>>>, residual: bool) -> Result<BranchSum<T>, LayerError> {
        let refused = |setting, got, expected| LayerError::InvalidSetting {
            layer: "Sum",
            setting,
            got,
            expected,
        };
        let Some(first) = branches.first() else {
            return Err(refused("number of branches", "0".to_owned(), "at least 1"));
        };
        if residual && first.in_shape() != first.out_shape() {
            let expected = "one whose output has the shape of its input";
            return Err(refused("branch", first.to_string(), expected));
        }
        let shapes = [first.in_shape(), first.out_shape()];
        for branch in &branches {
            if [branch.in_shape(), branch.out_shape()] != shapes {
                let expected = "one between the shapes of the first branch";
                return Err(refused("branch", branch.to_string(), expected));
            }
        }
        let printed: Vec<String> = branches.iter().map(|branch| branch.to_string()).collect();
        Ok(BranchSum {
            params: param_ranges(&branches),
            residual,
            scratch_key: hash_of(("Sum", residual, printed)),
            branches,
        })
    }

    /// Iterates over the branches of the sum with the ranges of their parameters.
    fn branches(&self) -> impl Iterator<Item = (&dyn Layer<T>, Range<usize>)> {
        let branches = self.branches.iter().map(|branch| branch.as_ref());
        branches.zip(self.params.iter().cloned())
    }
}

/// Splits the output of a branch and its scratch memory off the front of the sum's scratch memory.
fn take_branch<'a, T: Scalar>(
    branch: &dyn Layer<T>,
    samples: usize,
    scratch: &mut &'a mut [T],
) -> (&'a mut [T], &'a mut [T]) {
    let output = take_front_padded(scratch, samples * branch.out_shape().len());
    (output, take_front_padded(scratch, branch.scratch_len(samples)))
}

fn add<T: Scalar>(to: &mut [T], terms: &[T]) {
    for (sum, &term) in to.iter_mut().zip(terms) {
        *sum += term;
    }
}

impl<T: Scalar> LayerSignature for BranchSum<T> {
    fn in_shape(&self) -> Shape {
        self.branches[0].in_shape()
    }

    fn out_shape(&self) -> Shape {
        self.branches[0].out_shape()
    }

    fn num_params(&self) -> usize {
        self.params[self.params.len() - 1].end
    }

    /// Returns the length of the scratch memory: outputs and scratch memories of all branches, and
    /// one gradient of the input.
    fn scratch_len(&self, samples: usize) -> usize {
        let output = round_up_to_cache_line(samples * self.out_shape().len());
        let lens = self
            .branches()
            .map(|(branch, _)| output + round_up_to_cache_line(branch.scratch_len(samples)));
        lens.sum::<usize>() + samples * self.in_shape().len()
    }

    fn backward_reads_scratch(&self) -> bool {
        true
    }

    fn scratch_key(&self) -> u64 {
        self.scratch_key
    }
}

impl<T: Scalar> Layer<T> for BranchSum<T> {
    fn run_init(&self, rng: &mut dyn Rng, gain: f64, params: &mut [T]) {
        // second moments of independent terms add up
        let terms = self.branches.len() + usize::from(self.residual);
        for (branch, range) in self.branches() {
            branch.init_with_gain(rng, gain / (terms as f64).sqrt(), &mut params[range]);
        }
    }

    fn run_forward(&self, params: &[T], x: &[T], y: &mut [T], scratch: &mut [T]) {
        let samples = x.len() / self.in_shape().len();
        let mut rest = scratch;
        if self.residual {
            y.copy_from_slice(x);
        } else {
            y.fill(T::ZERO);
        }
        for (branch, range) in self.branches() {
            let (output, own) = take_branch(branch, samples, &mut rest);
            branch.run_forward(&params[range], x, output, own);
            add(y, output);
        }
    }

    fn run_backward(&self, args: BackwardArgs<T>) {
        let samples = args.x.len() / self.in_shape().len();
        let gradient = args.scratch.len() - args.x.len();
        let (mut rest, gradient) = args.scratch.split_at_mut(gradient);
        let mut dx = args.dx;
        if let Some(dx) = &mut dx {
            if self.residual {
                dx.copy_from_slice(args.dy);
            } else {
                dx.fill(T::ZERO);
            }
        }
        for (branch, range) in self.branches() {
            let (output, own) = take_branch(branch, samples, &mut rest);
            branch.run_backward(BackwardArgs {
                params: &args.params[range.clone()],
                x: args.x,
                y: output,
                dy: args.dy,
                dx: dx.is_some().then_some(&mut *gradient),
                dparams: &mut args.dparams[range],
                scratch: own,
            });
            if let Some(dx) = &mut dx {
                add(dx, gradient);
            }
        }
    }
}

impl<T: Scalar> fmt::Display for BranchSum<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let input = self.residual.then(|| "x".to_owned()).into_iter();
        let branches = self.branches.iter().map(|branch| branch.to_string());
        let terms: Vec<String> = input.chain(branches).collect();
        write!(f, "Sum({})", terms.join(" + "))
    }
}

impl<T: Scalar> fmt::Debug for BranchSum<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{self}")
    }
}

/// Returns examples of [`BranchSum`] for the tests that run on every kind of layer.
pub(super) fn test_layers<T: Scalar>(group: Group) -> Result<Vec<TestLayer<T>>, LayerError> {
    let shape = Shape::image(4, 3, group.regular_type(2));
    let same = SlidingWindow::new(3, 1, 1);
    let conv = || R2Conv::new(shape.fields, shape.fields, same, [4, 3]);
    let block = Sequential::new(vec![
        Box::new(conv()?) as Box<dyn Layer<T>>,
        Box::new(Relu::new(shape)?),
        Box::new(conv()?),
    ])?;
    let (relu, pool) = (Relu::new(shape)?, MaxPool::new(shape, same)?);
    let [from, to] = [[2, 1, 3, 0], [1, 2, 0, 2]].map(|irreps| FieldType::new(group, irreps));
    let linear = || Linear::new(from, to).map(|linear| Box::new(linear) as Box<dyn Layer<T>>);
    Ok(vec![
        TestLayer::exact("sum", BranchSum::new(vec![Box::new(relu), Box::new(pool)])?),
        TestLayer::exact("residual relu", BranchSum::residual(Box::new(Relu::new(shape)?))?),
        TestLayer::approximate("residual block", BranchSum::residual(Box::new(block))?),
        TestLayer::approximate("sum of linear", BranchSum::new(vec![linear()?, linear()?])?),
    ])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn relu(fields: FieldType) -> Box<dyn Layer<f64>> {
        Box::new(Relu::new(Shape::vector(fields)).unwrap())
    }

    #[test]
    fn branches_are_printed_and_those_of_other_shapes_refused_by_name() {
        let [one, two] = [1, 2].map(|n| Group::D2.trivial_type(n));
        let message = BranchSum::new(vec![relu(one), relu(two)]).unwrap_err().to_string();
        let expected = "Sum: got the branch Relu(1 x 1 x (2 1)), expected one between";
        assert!(message.starts_with(expected), "{message}");
        let widens = Box::new(Linear::new(one, two).unwrap());
        let residual = BranchSum::<f64>::residual(widens).unwrap_err().to_string();
        assert!(residual.contains("the shape of its input"), "{residual}");
        let empty = BranchSum::<f64>::new(Vec::new()).unwrap_err().to_string();
        assert!(empty.starts_with("Sum: got the number of branches 0"));
        let sum = BranchSum::residual(relu(one)).unwrap();
        assert_eq!(sum.to_string(), "Sum(x + Relu(1 x 1 x (1 1)))");
    }
}
