//! Times networks on request, for `layers.sh` and `roofline.py`: reads lines `<network> <task>
//! <threads>` and answers each with the milliseconds of one run.
//!
//! Networks: `reference`, `narrow`, `pooled`, `wide`. Tasks: `training` (forward and backward of a
//! batch), `inference` (of a batch), `latency` (of one image), `init` (layers, parameters and
//! buffers). `<network> multiplications` answers with the multiplications of one image's forward
//! pass instead: ours and those of the dense network.

mod networks;

use std::error::Error;
use std::io::{BufRead, Write, stdin, stdout};
use std::time::Instant;

use equivariant::{Layer, LayerError, LayerSignature, ParallelChunks, Scratch, Sequential};
use networks::build_d2_conv_network;
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};

const CHUNK: usize = 8;

#[derive(Clone, Copy)]
struct Spec {
    name: &'static str,
    size: usize,
    batch: usize,
    fields: &'static [usize],
    /// `true` for 3 x 3 convolutions followed by pooling, `false` for 4 x 4 ones of stride 2.
    pooled: bool,
}

const SPECS: [Spec; 4] = [
    Spec { name: "reference", size: 64, batch: 64, fields: &[8, 16, 32, 32], pooled: false },
    Spec { name: "narrow", size: 64, batch: 64, fields: &[4, 8, 16, 16], pooled: false },
    Spec { name: "pooled", size: 128, batch: 16, fields: &[8, 16, 32, 32, 32], pooled: true },
    Spec { name: "wide", size: 64, batch: 16, fields: &[16, 32, 64, 64], pooled: false },
];

impl Spec {
    fn build(&self) -> Result<Sequential<f32>, LayerError> {
        build_d2_conv_network(self.size, self.fields, self.pooled)
    }
}

/// Buffers of a thread.
struct Workspace {
    y: Vec<f32>,
    scratch: Scratch<f32>,
}

/// Network with its parameters, inputs and buffers.
struct Bench {
    spec: Spec,
    net: Sequential<f32>,
    params: Vec<f32>,
    gradient: Vec<f32>,
    chunks: ParallelChunks<f32, Workspace>,
    x: Vec<f32>,
    y: Vec<f32>,
    alone: Workspace,
}

impl Bench {
    fn new(spec: Spec) -> Result<Bench, LayerError> {
        let net = spec.build()?;
        let (out, scratch) = (CHUNK * net.out_shape().len(), net.allocate_scratch(CHUNK));
        let mut params = vec![0.0; net.num_params()];
        net.init(&mut ChaCha8Rng::seed_from_u64(0), &mut params);
        Ok(Bench {
            gradient: vec![0.0; params.len()],
            chunks: ParallelChunks::new(params.len(), CHUNK, move || Workspace {
                y: vec![0.0; out],
                scratch: scratch.clone(),
            }),
            x: (0..spec.batch * net.in_shape().len())
                .map(|i| (i * 37 % 101) as f32 / 50.0 - 1.0)
                .collect(),
            y: vec![0.0; spec.batch * net.out_shape().len()],
            alone: Workspace {
                y: vec![0.0; net.out_shape().len()],
                scratch: net.allocate_scratch(1),
            },
            params,
            net,
            spec,
        })
    }

    fn training(&mut self) {
        let (net, params, x) = (&self.net, &self.params, &self.x);
        let (in_len, out_len) = (net.in_shape().len(), net.out_shape().len());
        self.gradient.fill(0.0);
        let samples = x.len() / in_len;
        self.chunks.accumulate_gradients(samples, &mut self.gradient, |range, w, gradient| {
            let x = &x[range.start * in_len..range.end * in_len];
            let y = &mut w.y[..range.len() * out_len];
            net.forward(params, x, y, &mut w.scratch);
            // the gradient of half the squared output
            net.backward(params, x, y, y, None, gradient, &mut w.scratch);
        });
    }

    fn inference(&mut self) {
        let (net, params, x) = (&self.net, &self.params, &self.x);
        let (in_len, out_len) = (net.in_shape().len(), net.out_shape().len());
        self.chunks.map_rows(&mut self.y, out_len, |range, w, y| {
            let x = &x[range.start * in_len..range.end * in_len];
            net.forward(params, x, y, &mut w.scratch);
        });
    }

    fn latency(&mut self) {
        let x = &self.x[..self.net.in_shape().len()];
        let Workspace { y, scratch } = &mut self.alone;
        self.net.forward(&self.params, x, y, scratch);
    }

    fn run(&mut self, task: &str) -> Result<f64, String> {
        let start = Instant::now();
        match task {
            "training" => self.training(),
            "inference" => self.inference(),
            "latency" => self.latency(),
            "init" => {
                let net = self.spec.build().map_err(|error| error.to_string())?;
                net.init(&mut ChaCha8Rng::seed_from_u64(0), &mut self.params);
            }
            other => return Err(format!("got the task `{other}`")),
        }
        let elapsed = start.elapsed().as_secs_f64();
        let result = self.gradient.iter().chain(&self.y).chain(&self.alone.y);
        let sum: f32 = result.map(|v| v.abs()).sum();
        assert!(sum.is_finite() && (sum > 0.0 || task == "init"));
        Ok(1e3 * elapsed)
    }

    /// Returns the numbers of multiplications of a forward pass of one image: ours, and the dense
    /// network's.
    fn multiplications(&self) -> [usize; 2] {
        let layers = self.net.layers().iter();
        let dense =
            layers.filter_map(|layer| Some((layer.kind().as_ordinary_conv()?, layer.num_params())));
        dense.fold([0; 2], |[ours, theirs], (dense, params)| {
            let pixels = dense.out_shape().num_pixels();
            let entries: usize = dense.kernel_shape().iter().product();
            [ours + params * pixels, theirs + entries * pixels]
        })
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    let pools = [1, 2].map(|threads| rayon::ThreadPoolBuilder::new().num_threads(threads).build());
    let benches: Result<Vec<Bench>, _> = SPECS.into_iter().map(Bench::new).collect();
    let mut benches = benches?;
    for line in stdin().lock().lines() {
        let line = line?;
        let words: Vec<&str> = line.split_whitespace().collect();
        let [name, task, threads] = words[..] else {
            return Err(format!("got `{line}`, expected a network, a task and a number").into());
        };
        let bench = benches.iter_mut().find(|bench| bench.spec.name == name);
        let bench = bench.ok_or_else(|| format!("got the network `{name}`"))?;
        let threads: usize = threads.parse()?;
        if task == "multiplications" {
            let [ours, theirs] = bench.multiplications();
            println!("{ours} {theirs}");
        } else {
            let pool = pools.get(threads - 1).and_then(|pool| pool.as_ref().ok());
            let pool = pool.ok_or_else(|| format!("got {threads} threads, expected 1 or 2"))?;
            println!("{}", pool.install(|| bench.run(task))?);
        }
        stdout().flush()?;
    }
    Ok(())
}
