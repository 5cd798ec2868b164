//! Drawing through EGL, and properties of renderers with any backend.

#![allow(clippy::unwrap_used, reason = "test code")]

mod support;

use std::f64::consts::FRAC_PI_2;
use std::sync::Arc;
use std::thread;

use mujoco::{
    Data, FreeCamera, Model, OpenGlBackend, RenderError, RenderOptions, Renderer, StaticBackdrop,
};

/// Size of the images, in pixels. They are not square, or width and height could be exchanged.
const WIDTH: usize = 12;
const HEIGHT: usize = 8;

const SURFACELESS: [OpenGlBackend; 1] = [OpenGlBackend::EglSurfaceless];

const SCENE: &str = r#"<mujoco>
  <visual><headlight ambient="1 1 1" diffuse="0 0 0" specular="0 0 0"/></visual>
  <worldbody>
    <camera name="top" pos="0 0 2"/>
    <geom name="near" type="box" size="5 5 .1" pos="0 0 .2" group="1" rgba="1 0 0 1"/>
    <geom name="far" type="box" size="5 5 .1" rgba="0 1 0 1"/>
    <site name="mark" type="box" size="5 5 .1" pos="0 0 .5" rgba="0 0 1 1"/>
  </worldbody></mujoco>"#;

#[test]
fn rows_and_columns_are_where_they_belong_and_mirrored_scenes_give_mirror_images() {
    support::check_pictures(&SURFACELESS);
}

#[test]
fn a_pixel_buffer_does_as_well() {
    support::check_orientation(&[OpenGlBackend::EglPbuffer]);
}

#[test]
fn groups_are_shown_and_hidden() {
    let shown = |groups: &[usize], sites: &[usize]| {
        let options = RenderOptions {
            visible_geom_groups: [0, 1, 2, 3, 4, 5].map(|group| groups.contains(&group)),
            visible_site_groups: [0, 1, 2, 3, 4, 5].map(|group| sites.contains(&group)),
            ..RenderOptions::default()
        };
        centre_pixel(options)
    };
    assert_eq!(shown(&[0, 1], &[]), [255, 0, 0]);
    assert_eq!(shown(&[0], &[]), [0, 255, 0]);
    assert_eq!(shown(&[0, 1], &[0]), [0, 0, 255]);
    assert_eq!(shown(&[], &[]), [0, 0, 0]);
}

#[test]
fn a_free_camera_sees_the_side_that_it_looks_at() {
    let xml = r#"<mujoco>
      <visual><headlight ambient="1 1 1" diffuse="0 0 0" specular="0 0 0"/></visual>
      <worldbody>
        <geom type="box" pos="1 0 0" size=".1 .9 .9" rgba="1 0 0 1"/>
        <geom type="box" pos="0 1 0" size=".9 .1 .9" rgba="0 1 0 1"/>
        <geom type="box" pos="0 0 1" size=".9 .9 .1" rgba="0 0 1 1"/>
      </worldbody></mujoco>"#;
    let (mut data, mut renderer) = ready(xml, RenderOptions::default());
    let mut image = vec![0; renderer.image_len()];
    let quarter = FRAC_PI_2;
    for (azimuth, elevation, colour) in [
        (2.0 * quarter, 0.0, [255, 0, 0]),
        (-quarter, 0.0, [0, 255, 0]),
        (0.3, -quarter, [0, 0, 255]),
    ] {
        let camera = FreeCamera { target: [0.0; 3], distance: 4.0, azimuth, elevation };
        renderer.render_from(&mut data, &camera, &mut image).unwrap();
        let middle = 3 * (HEIGHT / 2 * WIDTH + WIDTH / 2);
        assert_eq!(image[middle..middle + 3], colour, "{camera:?}");
        for invalid in [
            FreeCamera { distance: 0.0, ..camera },
            FreeCamera { distance: f64::NAN, ..camera },
            FreeCamera { target: [0.0, 0.0, f64::NAN], ..camera },
            FreeCamera { azimuth: f64::INFINITY, ..camera },
            FreeCamera { elevation: f64::NAN, ..camera },
        ] {
            let error = renderer.render_from(&mut data, &invalid, &mut image).unwrap_err();
            assert!(matches!(error, RenderError::InvalidFreeCamera { .. }), "{error}");
        }
    }
}

fn centre_pixel(options: RenderOptions) -> [u8; 3] {
    let (mut data, mut renderer) = ready(SCENE, options);
    let image = draw(&mut data, &mut renderer);
    let middle = 3 * (HEIGHT / 2 * WIDTH + WIDTH / 2);
    [image[middle], image[middle + 1], image[middle + 2]]
}

fn ready(xml: &str, options: RenderOptions) -> (Data, Renderer) {
    let model = Arc::new(Model::from_xml(xml).unwrap());
    let mut data = Data::new(model.clone());
    data.forward().unwrap();
    (data, Renderer::with_backends(model, WIDTH, HEIGHT, options, &SURFACELESS).unwrap())
}

fn draw(data: &mut Data, renderer: &mut Renderer) -> Vec<u8> {
    let camera = data.model().camera("top").unwrap();
    let mut image = vec![7; renderer.image_len()];
    renderer.render(data, camera, &mut image).unwrap();
    image
}

#[test]
fn renderers_of_one_thread_keep_out_of_each_others_way() {
    let other = SCENE.replace("1 0 0 1", "0 0 1 1");
    let (mut red_data, mut red) = ready(SCENE, RenderOptions::default());
    let (mut blue_data, mut blue) = ready(&other, RenderOptions::default());
    let first = draw(&mut red_data, &mut red);
    assert_eq!(first[..3], [255, 0, 0]);
    for _ in 0..3 {
        assert_eq!(draw(&mut blue_data, &mut blue)[..3], [0, 0, 255]);
        assert_eq!(draw(&mut red_data, &mut red), first);
    }
    drop(blue);
    assert_eq!(draw(&mut red_data, &mut red), first);
}

#[test]
fn threads_draw_the_same_image() {
    let images = [0; 4].map(|_| {
        thread::spawn(|| {
            let (mut data, mut renderer) = ready(SCENE, RenderOptions::default());
            (0..20).map(|_| draw(&mut data, &mut renderer)).collect::<Vec<_>>()
        })
    });
    let images: Vec<_> = images.into_iter().flat_map(|thread| thread.join().unwrap()).collect();
    assert!(images.iter().all(|image| image[..3] == [255, 0, 0] && *image == images[0]));
}

#[test]
fn shadows_are_off_unless_asked_for() {
    let xml = r#"<mujoco><worldbody>
        <camera name="top" pos="0 0 2"/>
        <light directional="true" pos="-2 0 3" dir="1 0 -1"/>
        <geom type="box" size="5 5 .1"/><geom type="box" size=".05 .05 .05" pos="-.5 0 .7"/>
      </worldbody></mujoco>"#;
    let image_with = |shadows| {
        let (mut data, mut renderer) =
            ready(xml, RenderOptions { shadows, ..RenderOptions::default() });
        draw(&mut data, &mut renderer)
    };
    assert_ne!(image_with(true), image_with(false));
}

/// A slanted edge under uniform light: multisampling would mix the two colours along it.
#[test]
fn edges_are_not_smoothed() {
    let xml = r#"<mujoco><visual><quality offsamples="4"/><headlight ambient="1 1 1" diffuse="0 0 0" specular="0 0 0"/></visual>
      <worldbody>
        <camera name="top" pos="0 0 2"/>
        <geom type="box" size=".5 .3 .1" euler="0 0 25" rgba="1 1 1 1"/>
      </worldbody></mujoco>"#;
    let (mut data, mut renderer) = ready(xml, RenderOptions::default());
    let mut levels = draw(&mut data, &mut renderer);
    levels.sort_unstable();
    levels.dedup();
    assert_eq!(levels, [0, 255]);
}

/// A reflecting floor below a red ball: a reflection would be visible beside the ball.
#[test]
fn mirrors_do_not_reflect() {
    let image = |reflectance| {
        let xml = format!(
            r#"<mujoco>
                 <asset><material name="mirror" reflectance="{reflectance}" rgba=".5 .5 .5 1"/></asset>
                 <worldbody>
                   <camera name="top" pos="0 -1 1" euler="45 0 0"/>
                   <geom type="plane" size="3 3 .1" material="mirror"/>
                   <geom type="sphere" size=".2" pos="0 .5 .8" rgba="1 0 0 1"/>
                 </worldbody></mujoco>"#
        );
        let (mut data, mut renderer) = ready(&xml, RenderOptions::default());
        draw(&mut data, &mut renderer)
    };
    assert_eq!(image(0.9), image(0.0));
}

#[test]
fn bad_arguments_are_refused() {
    let (mut data, mut renderer) = ready(SCENE, RenderOptions::default());
    let camera = data.model().camera("top").unwrap();
    let short = renderer.render(&mut data, camera, &mut [0; 5]);
    assert_eq!(short, Err(RenderError::WrongImageLength { expected: 3 * WIDTH * HEIGHT, got: 5 }));

    let (mut other, _) = ready(SCENE, RenderOptions::default());
    let mut image = vec![0; renderer.image_len()];
    assert_eq!(renderer.render(&mut other, camera, &mut image), Err(RenderError::OtherModel));

    let moved = Arc::new(data.model().translated([0.0, 0.0, 1.0]).unwrap());
    let refused = renderer.render(&mut Data::new(moved), camera, &mut image);
    assert_eq!(refused, Err(RenderError::OtherModel));
    let twin = Arc::new(data.model().with_mirrored_bodies(&[]).unwrap());
    renderer.render(&mut Data::new(twin), camera, &mut image).unwrap();

    let undrawn =
        renderer.render_over_backdrop(&mut data, &mut StaticBackdrop::default(), &mut image);
    assert_eq!(undrawn, Err(RenderError::NoBackdrop));

    let model = data.model().clone();
    for (width, height) in [(0, 8), (8, 4097)] {
        let sized = Renderer::new(model.clone(), width, height, RenderOptions::default());
        assert!(matches!(sized, Err(RenderError::ImageSizeOutOfRange { .. })));
    }
}

#[test]
fn a_camera_of_a_larger_model_is_refused() {
    let two = Model::from_xml(
        r#"<mujoco><worldbody><camera name="a"/><camera name="b"/></worldbody></mujoco>"#,
    );
    let camera = two.unwrap().camera("b").unwrap();
    let (mut data, mut renderer) = ready(SCENE, RenderOptions::default());
    let refused = renderer.render(&mut data, camera, &mut [0; 3 * WIDTH * HEIGHT]);
    assert_eq!(refused, Err(RenderError::UnknownCamera { index: 1, count: 1 }));
}
