//! Drawing checks for every backend; one test program per OpenGL library, because a process can use
//! one only. A missing backend fails the test instead of skipping it.

#![allow(clippy::unwrap_used, reason = "test code")]

use std::fmt::Write;
use std::sync::Arc;

use mujoco::{Data, Model, OpenGlBackend, RenderOptions, Renderer};

/// Size of the images, in pixels. They are not square, or width and height could be exchanged.
const WIDTH: usize = 64;
const HEIGHT: usize = 48;
const RED: [f64; 3] = [1.0, 0.0, 0.0];
const GREEN: [f64; 3] = [0.0, 1.0, 0.0];
const BLUE: [f64; 3] = [0.0, 0.0, 1.0];
const YELLOW: [f64; 3] = [1.0, 1.0, 0.0];

/// Geom of a scene: type, size, (x, y) in metres, angle about z in degrees, colour.
type Prop = (&'static str, &'static str, [f64; 2], f64, [f64; 3]);

/// Runs all checks.
pub fn check_pictures(backends: &[OpenGlBackend]) {
    check_orientation(backends);
    check_mirrored_scenes(backends);
}

/// Row 0 is the largest y, column 0 the smallest x, and channels are red, green, blue.
pub fn check_orientation(backends: &[OpenGlBackend]) {
    let boxes: [Prop; 4] = [
        ("box", ".1 .1 .1", [0.5, 0.0], 0.0, RED),
        ("box", ".1 .1 .1", [-0.5, 0.0], 0.0, GREEN),
        ("box", ".1 .1 .1", [0.0, 0.5], 0.0, BLUE),
        ("box", ".1 .1 .1", [0.0, -0.5], 0.0, YELLOW),
    ];
    let image = draw(&boxes, backends);
    let (row, column) = (HEIGHT / 2, WIDTH / 2);
    // half the height is 2 m * tan(45 deg / 2) = 0.83 m at z = 0: 0.5 m is 15 pixels
    assert_colour(&image, (row, column + 15), RED);
    assert_colour(&image, (row, column - 15), GREEN);
    assert_colour(&image, (row - 15, column), BLUE);
    assert_colour(&image, (row + 15, column), YELLOW);
    assert_colour(&image, (row, column), [0.0; 3]);
}

/// Mirrored scenes must give mirrored images, bit for bit, under all four elements of D2. The scene
/// itself is not symmetric, or the check would prove nothing.
///
/// Round props stand upright: MuJoCo cuts a round shape into quads and OpenGL each quad into two
/// triangles, along a diagonal that does not mirror. Under light from above the quads of a lying
/// shape are not shaded uniformly along the cut, and pixels there differ by a few levels.
fn check_mirrored_scenes(backends: &[OpenGlBackend]) {
    let original = draw(&props(1.0, 1.0), backends);
    for (sign_x, sign_y) in [(1.0, 1.0), (-1.0, 1.0), (1.0, -1.0), (-1.0, -1.0)] {
        let expected = mirrored(&original, sign_x < 0.0, sign_y < 0.0);
        let moved = sign_x * sign_y < 0.0 || sign_x < 0.0;
        assert_eq!(expected != original, moved, "the scene must have no symmetry");
        let drawn = draw(&props(sign_x, sign_y), backends);
        let wrong = drawn.iter().zip(&expected).filter(|(a, b)| a != b).count();
        assert_eq!(wrong, 0, "bytes that differ under signs ({sign_x}, {sign_y})");
    }
}

fn props(sign_x: f64, sign_y: f64) -> [Prop; 6] {
    let props: [Prop; 6] = [
        ("box", ".12 .05 .04", [0.31, 0.17], 25.0, RED),
        ("box", ".04 .21 .1", [-0.47, -0.23], 0.0, GREEN),
        ("sphere", ".09", [0.13, -0.39], 0.0, BLUE),
        ("cylinder", ".11 .06", [-0.21, 0.41], 0.0, YELLOW),
        ("capsule", ".05 .1", [0.52, -0.44], 0.0, [0.3, 0.9, 0.6]),
        ("box", ".02 .02 .3", [0.03, 0.08], 0.0, [0.8, 0.4, 0.9]),
    ];
    props.map(|(shape, size, [x, y], angle, colour)| {
        (shape, size, [sign_x * x, sign_y * y], sign_x * sign_y * angle, colour)
    })
}

fn draw(props: &[Prop], backends: &[OpenGlBackend]) -> Vec<u8> {
    let model = Arc::new(Model::from_xml(&scene(props)).unwrap());
    let camera = model.camera("top").unwrap();
    let mut data = Data::new(model.clone());
    data.forward().unwrap();
    let mut renderer =
        Renderer::with_backends(model, WIDTH, HEIGHT, RenderOptions::default(), backends)
            .unwrap_or_else(|error| panic!("this test needs OpenGL and never skips: {error}"));
    assert!(backends.contains(&renderer.backend()));
    let mut image = vec![0; renderer.image_len()];
    renderer.render(&mut data, camera, &mut image).unwrap();
    image
}

fn scene(props: &[Prop]) -> String {
    let mut geoms = String::new();
    for (shape, size, [x, y], angle, [r, g, b]) in props {
        writeln!(
            geoms,
            r#"<geom type="{shape}" size="{size}" pos="{x} {y} 0" euler="0 0 {angle}" rgba="{r} {g} {b} 1"/>"#
        )
        .unwrap();
    }
    format!(
        r#"<mujoco><compiler angle="degree" eulerseq="XYZ"/>
             <visual>
               <quality numslices="10" numstacks="6" numquads="1"/>
               <headlight ambient=".13 .13 .13" specular="0 0 0"/>
             </visual>
             <worldbody>
               <camera name="top" pos="0 0 2" fovy="45"/>
               <light directional="true" pos="0 0 3" dir="0 0 -1" specular="0 0 0"/>
               {geoms}
             </worldbody></mujoco>"#
    )
}

fn assert_colour(image: &[u8], (row, column): (usize, usize), colour: [f64; 3]) {
    let pixel = &image[3 * (row * WIDTH + column)..][..3];
    for (byte, channel) in pixel.iter().zip(colour) {
        let as_asked = if channel > 0.5 { *byte > 100 } else { *byte < 60 };
        assert!(as_asked, "pixel ({row}, {column}) is {pixel:?}, expected {colour:?}");
    }
}

fn mirrored(image: &[u8], flip_x: bool, flip_y: bool) -> Vec<u8> {
    let mut out = Vec::with_capacity(image.len());
    for row in 0..HEIGHT {
        for column in 0..WIDTH {
            let row = if flip_y { HEIGHT - 1 - row } else { row };
            let column = if flip_x { WIDTH - 1 - column } else { column };
            out.extend_from_slice(&image[3 * (row * WIDTH + column)..][..3]);
        }
    }
    out
}
