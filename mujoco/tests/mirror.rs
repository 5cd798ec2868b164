//! Drawing in a mirror: the picture is that of the scene, and mirrored scenes have mirrored
//! pictures bit for bit.

#![allow(clippy::unwrap_used, reason = "test code")]

use std::fmt::Write;
use std::sync::Arc;

use mujoco::{CameraAndMirror, Data, Model, RenderError, RenderMirror, RenderOptions, Renderer};

/// Size of the images, in pixels. They are not square, or width and height could be exchanged.
const WIDTH: usize = 80;
const HEIGHT: usize = 64;
const MIRRORS: [RenderMirror; 4] =
    [mirror(false, false), mirror(true, false), mirror(false, true), mirror(true, true)];

const fn mirror(columns: bool, rows: bool) -> RenderMirror {
    RenderMirror { swaps_left_right: columns, swaps_top_bottom: rows }
}

/// Draws numbers in `[0, 1)` with a linear congruential generator.
struct Numbers(u64);

impl Numbers {
    fn next(&mut self) -> f64 {
        self.0 =
            self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 40) as f64 / (1_u64 << 24) as f64
    }

    fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.next()
    }
}

/// Returns a scene of tilted props on a grid of pixel centres, so that edges often hit them, under
/// a light from the side; mirrored.
fn scene(seed: u64, mirror: RenderMirror) -> String {
    let [x, y] = [mirror.swaps_left_right, mirror.swaps_top_bottom]
        .map(|flips| if flips { -1.0 } else { 1.0 });
    let (mut numbers, mut props) = (Numbers(seed), String::new());
    for shape in ["box", "sphere", "capsule", "cylinder", "ellipsoid", "box"] {
        let [px, py] = [(); 2].map(|()| (numbers.between(-20.0, 20.0).floor() + 0.5) / 40.0);
        let sizes = [(); 3].map(|()| (numbers.between(2.0, 8.0).floor()) / 40.0);
        let (turn, tilt) = match shape {
            "box" if numbers.next() < 0.7 => (0.0, 0.0),
            _ => (numbers.between(0.0, 6.0), numbers.between(0.0, 1.0)),
        };
        let axis = [f64::cos(turn), f64::sin(turn), 0.0];
        let other =
            [-f64::sin(turn) * f64::cos(tilt), f64::cos(turn) * f64::cos(tilt), f64::sin(tilt)];
        // the prop is symmetric across its x axis
        let sign = x * y;
        let [ax, ay, az] = [sign * x * axis[0], sign * y * axis[1], sign * axis[2]];
        let [ox, oy, oz] = [x * other[0], y * other[1], other[2]];
        let [r, g, b] = [(); 3].map(|()| numbers.next());
        let [sx, sy, sz] = sizes;
        writeln!(
            props,
            r#"<geom type="{shape}" size="{sx} {sy} {sz}" pos="{} {} 0" xyaxes="{ax} {ay} {az} {ox} {oy} {oz}" rgba="{r} {g} {b} 1"/>"#,
            x * px,
            y * py
        )
        .unwrap();
    }
    format!(
        r#"<mujoco>
             <visual><quality numslices="10" numstacks="6" numquads="1"/><headlight ambient=".2 .2 .2" diffuse=".3 .3 .3"/></visual>
             <worldbody>
               <camera name="top" pos="0 0 2" fovy="43.6028"/>
               <light directional="true" pos="0 0 3" dir="{} {} -1"/>
               {props}
               <body pos="{} 0 .3"><joint type="slide" axis="0 0 1"/><geom size=".06" rgba="1 1 1 1"/></body>
             </worldbody></mujoco>"#,
        0.3 * x,
        -0.4 * y,
        0.1 * x
    )
}

fn ready(xml: &str) -> (Data, Renderer) {
    let model = Arc::new(Model::from_xml(xml).unwrap());
    let mut data = Data::new(Arc::clone(&model));
    data.forward().unwrap();
    (data, Renderer::new(model, WIDTH, HEIGHT, RenderOptions::default()).unwrap())
}

fn picture(
    (data, renderer): &mut (Data, Renderer),
    mirror: RenderMirror,
) -> Result<Vec<u8>, RenderError> {
    let camera = data.model().camera("top").unwrap();
    let mut image = vec![0; renderer.image_len()];
    renderer.render(data, CameraAndMirror { camera, mirror }, &mut image).map(|()| image)
}

fn mirrored(image: &[u8], mirror: RenderMirror) -> Vec<u8> {
    let at = |flips: bool, index: usize, size: usize| if flips { size - 1 - index } else { index };
    let pixels = (0..HEIGHT * WIDTH).map(|i| {
        let row = at(mirror.swaps_top_bottom, i / WIDTH, HEIGHT);
        row * WIDTH + at(mirror.swaps_left_right, i % WIDTH, WIDTH)
    });
    pixels.flat_map(|pixel| image[3 * pixel..][..3].to_vec()).collect()
}

/// Counts the pixels in which a channel differs by more than the given levels.
fn differing(a: &[u8], b: &[u8], levels: u8) -> usize {
    let far = |(p, q): &(&[u8], &[u8])| p.iter().zip(*q).any(|(p, q)| p.abs_diff(*q) > levels);
    a.chunks_exact(3).zip(b.chunks_exact(3)).filter(far).count()
}

#[test]
fn twins_drawn_in_the_mirror_between_them_mirror_bit_for_bit() {
    let mut inexact = 0;
    for seed in 0..60 {
        let canonical =
            picture(&mut ready(&scene(seed, RenderMirror::default())), RenderMirror::default())
                .unwrap();
        for mirror in MIRRORS {
            let mut twin = ready(&scene(seed, mirror));
            let expected = mirrored(&canonical, mirror);
            let differs = differing(&picture(&mut twin, mirror).unwrap(), &expected, 0);
            assert_eq!(differs, 0, "scene {seed}, {mirror:?}");
            let direct = picture(&mut twin, RenderMirror::default()).unwrap();
            inexact += usize::from(differing(&direct, &expected, 0) > 0);
        }
    }
    assert!(
        inexact > 100,
        "without mirrors only {inexact} of 240 differ, so the scenes are too easy"
    );
}

/// A tetrahedron without symmetry: one flip would need its mirror image, which is another shape;
/// two flips are a rotation.
#[test]
fn what_is_not_its_own_mirror_image_is_refused() {
    let mut ready = ready(
        r#"<mujoco><asset><mesh name="wedge" vertex="0 0 0  .5 0 0  0 .3 0  .1 .1 .4"/></asset>
             <worldbody><camera name="top" pos="0 0 2"/><geom type="mesh" mesh="wedge" pos=".1 .2 0"/></worldbody></mujoco>"#,
    );
    let direct = picture(&mut ready, MIRRORS[0]).unwrap();
    for mirror in [MIRRORS[1], MIRRORS[2]] {
        let refused = picture(&mut ready, mirror).unwrap_err();
        assert_eq!(refused, RenderError::NotMirrorSymmetric { what: "geom", index: 0 });
        assert!(refused.to_string().contains("geom 0 is not mirror-symmetric"));
    }
    let turned = picture(&mut ready, MIRRORS[3]).unwrap();
    assert!(differing(&direct, &vec![0; direct.len()], 0) > 100);
    assert!(differing(&direct, &turned, 0) <= 8, "{}", differing(&direct, &turned, 0));
}
