//! Variants of a world are mirror images of each other, to the bit.

#![allow(clippy::unwrap_used)]

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rl::{EnvSpec, Observations, Transition, VectorEnv};
use symmetry::D2;
use worlds::{GroupVisit, TaskStream, World, WorldKind};

fn stream(kind: WorldKind, seed: u64, variant: D2) -> TaskStream {
    let world = World::random(kind, seed);
    let groups = world.groups.len();
    let visits = (0..2).map(|visit| GroupVisit::new(visit % groups, 1)).collect();
    let stream = TaskStream::new(world, visits, 2).unwrap();
    stream.mirrored_by(variant).with_horizon(6)
}

fn mirrored(g: D2, components: &[f32]) -> Vec<f32> {
    let signs = [symmetry::Irrep::X, symmetry::Irrep::Y].map(|irrep| f32::from(irrep.sign(g)));
    components.iter().zip(signs.iter().cycle()).map(|(c, s)| c * s).collect()
}

fn moved(g: D2, observations: &Observations, spec: &EnvSpec) -> Observations {
    let [height, width, channels] = spec.image_shape;
    let images = observations.images.chunks(spec.image_len());
    Observations {
        images: images
            .flat_map(|image| g.transform_image(image, height, width, channels))
            .collect(),
        vectors: mirrored(g, &observations.vectors),
    }
}

/// Compares a stream, mirrored by `g`, with that of the variant `variant` under mirrored actions
/// over two groups.
fn is_equivariant(kind: WorldKind, seed: u64, g: D2, variant: D2) -> bool {
    let (mut one, mut other) = (stream(kind, seed, D2::Identity), stream(kind, seed, variant));
    let spec = one.spec().clone();
    let mut seen = [Observations::new(&spec), Observations::new(&spec)];
    one.reset(&mut seen[0]).unwrap();
    other.reset(&mut seen[1]).unwrap();
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut out = [Transition::new(&spec), Transition::new(&spec)];
    let mut equal = moved(g, &seen[0], &spec) == seen[1];
    for _ in 0..13 {
        let actions: Vec<f32> = (0..4).map(|_| rng.random_range(-1.5..1.5)).collect();
        one.step(&actions, &mut out[0]).unwrap();
        other.step(&mirrored(g, &actions), &mut out[1]).unwrap();
        out[0].check(&spec).unwrap();
        equal &= moved(g, &out[0].observations, &spec) == out[1].observations;
        equal &= out[0].rewards == out[1].rewards && out[0].outcomes == out[1].outcomes;
    }
    equal
}

#[test]
fn all_kinds_are_equivariant_to_the_bit() {
    for kind in WorldKind::ALL {
        for g in D2::ALL {
            for seed in 1000..1003 {
                assert!(is_equivariant(kind, seed, g, g), "{} {g} {seed}", kind.name());
            }
        }
    }
    assert!(!is_equivariant(WorldKind::Shape, 1000, D2::FlipY, D2::FlipX), "a wrong mirror");
}
