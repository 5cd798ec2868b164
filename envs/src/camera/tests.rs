//! Settings, marks and projection.

use std::sync::Arc;

use mujoco::{Data, Model, RenderOptions, Renderer};
use symmetry::D2;

use super::*;

#[test]
fn settings_out_of_range_are_refused_with_their_value() {
    type Change = fn(&mut Camera);
    let broken: [(Change, &str); 19] = [
        (|c| c.size = 47, "image size` is 47"),
        (|c| c.size = 1 << 40, "image size"),
        (|c| c.half_extent = 0.0, "half extent` is 0"),
        (|c| c.height = 0.2, "height` is 0.2"),
        (|c| c.background[1] = 1.5, "background` is 1.5"),
        (|c| c.light.ambient = -0.1, "ambient light` is -0.1"),
        (|c| c.light.overhead = f64::NAN, "overhead light` is NaN"),
        (|c| c.mark.radius = -1.0, "mark radius` is -1"),
        (|c| c.mark.hole = 0.04, "mark hole` is 0.04"),
        (|c| c.oversampling = 0, "oversampling` is 0"),
        (|c| c.oversampling = 9, "oversampling` is 9"),
        (|c| (c.size, c.oversampling) = (1024, 8), "size times oversampling` is 8192"),
        (|c| c.misalignment.shift_mm[1] = -201.0, "shift_mm` is -201"),
        (|c| c.misalignment.tilt_degrees[0] = 20.5, "tilt_degrees` is 20.5"),
        (|c| c.misalignment.tilt_degrees[1] = f64::NAN, "tilt_degrees` is NaN"),
        (|c| c.arm_occlusion = -0.1, "arm_occlusion` is -0.1"),
        (|c| c.arm_occlusion = 1.5, "arm_occlusion` is 1.5"),
        (|c| c.arm_occlusion = f64::NAN, "arm_occlusion` is NaN"),
        (|c| (c.arm_occlusion, c.misalignment.shift_mm) = (0.5, [30.0, 0.0]), "misaligned camera"),
    ];
    for (change, says) in broken {
        let mut camera = Camera::default();
        change(&mut camera);
        let message = camera.check().unwrap_err().to_string();
        assert!(message.contains(says), "{message}");
    }
    assert!(Camera::default().check().is_ok());
}

#[test]
fn settings_travel_as_text() {
    let camera = Camera {
        height: 1.2,
        background: [0.1, 0.2, 0.3],
        mark: GripperMark { hole: 0.01, ..GripperMark::default() },
        oversampling: 3,
        extra_views: ExtraViews::CloseUp,
        misalignment: Misalignment { shift_mm: [3.0, -4.0], tilt_degrees: [0.0, 1.5] },
        ..Camera::default()
    };
    let text = serde_json::to_string(&camera).unwrap();
    assert_eq!(serde_json::from_str::<Camera>(&text).unwrap(), camera);
    let added = [
        r#","beside":"close_up""#,
        r#""oversampling":3,"#,
        r#","misalignment":{"shift_mm":[3.0,-4.0],"tilt_degrees":[0.0,1.5]}"#,
    ];
    let before = added.iter().fold(text.clone(), |before, part| before.replace(part, ""));
    let before = serde_json::from_str::<Camera>(&before).unwrap();
    assert_eq!((before.oversampling, before.extra_views), (1, ExtraViews::First));
    assert!(before.is_aligned() && !camera.is_aligned());
    let unknown = text.replace("height", "hight");
    let message = serde_json::from_str::<Camera>(&unknown).unwrap_err();
    assert!(message.to_string().contains("hight"), "{message}");
}

fn draw(camera: &Camera, point: DVec3) -> Vec<u8> {
    let mut rgb = vec![0; camera.size * camera.size * 3];
    camera.draw_gripper_mark(&camera.mark, point, &mut rgb);
    rgb
}

#[test]
fn the_mark_of_a_mirrored_point_is_the_mirrored_mark() {
    for hole in [0.0, 0.02] {
        let mut camera = Camera::default();
        camera.mark.hole = hole;
        let point = DVec3::new(0.137, 0.083, 0.2);
        let picture = draw(&camera, point);
        assert!(picture.contains(&255));
        for g in D2::ALL {
            let [x, y] = g.apply_xy([point.x, point.y]);
            let mirrored = g.transform_image(&picture, camera.size, camera.size, 3);
            assert_eq!(draw(&camera, DVec3::new(x, y, point.z)), mirrored, "{g}");
        }
    }
}

/// Draws the mark by its definition, pixel by pixel over the whole picture.
fn slow_mark(camera: &Camera, point: DVec3) -> Vec<u8> {
    let metres = 2.0 * camera.half_extent / camera.size as f64;
    let middle = camera.size as f64 / 2.0;
    let [u, v] = camera.project(point);
    let pixels = (0..camera.size * camera.size).flat_map(|index| {
        let (row, col) = (index / camera.size, index % camera.size);
        let dx = col as f64 + 0.5 - middle - u;
        let dy = middle - (row as f64 + 0.5) - v;
        let distance = dx.hypot(dy) * metres;
        let inside = distance < camera.mark.radius && distance >= camera.mark.hole;
        if inside { camera.mark.color } else { [0; 3] }
    });
    pixels.collect()
}

#[test]
fn marks_are_discs_and_rings_also_across_the_edge() {
    let points = [[0.11, -0.07, 0.0], [-0.44, 0.44, 0.1], [0.43, 0.0, 0.3], [2.0, -3.0, 0.0]];
    for (radius, hole) in [(0.03, 0.0), (0.1, 0.06), (0.0, 0.0), (0.05, 0.05)] {
        let camera =
            Camera { mark: GripperMark { radius, hole, color: [9, 8, 7] }, ..Camera::default() };
        for point in points.map(DVec3::from_array) {
            assert!(draw(&camera, point) == slow_mark(&camera, point), "{point}");
        }
    }
}

/// Small boxes, one pure colour each, at points off every axis.
const POINTS: [([f64; 3], usize); 3] =
    [([0.21, 0.13, 0.05], 0), ([-0.17, 0.29, 0.3], 1), ([0.33, -0.26, -0.2], 2)];

/// Renders the boxes mapped by `g`.
fn draw_points(camera: &Camera, g: D2) -> Vec<u8> {
    let boxes = POINTS.map(|([x, y, z], channel)| {
        let [x, y] = g.apply_xy([x, y]);
        let rgb = ["1 0 0", "0 1 0", "0 0 1"][channel];
        format!(r#"<geom type="box" size=".01 .01 .001" pos="{x} {y} {z}" rgba="{rgb} 1"/>"#)
    });
    let scene = camera.to_mjcf("top");
    let xml = format!("<mujoco>{scene}<worldbody>{}</worldbody></mujoco>", boxes.concat());
    let model = Arc::new(Model::from_xml(&xml).unwrap());
    let mut data = Data::new(Arc::clone(&model));
    data.forward().unwrap();
    let top = model.camera("top").unwrap();
    let options = RenderOptions::default();
    let mut renderer = Renderer::new(model, camera.size, camera.size, options).unwrap();
    let mut rgb = vec![0; renderer.image_len()];
    renderer.render(&mut data, top, &mut rgb).unwrap();
    rgb
}

/// Mean position of the pixels lit in `channel`: pixels right of and above the image's centre.
fn centroid(rgb: &[u8], size: usize, channel: usize) -> [f64; 2] {
    let (mut u, mut v, mut count) = (0.0, 0.0, 0.0);
    for (index, pixel) in rgb.chunks_exact(3).enumerate() {
        if pixel[channel] > 100 {
            u += (index % size) as f64 + 0.5 - size as f64 / 2.0;
            v += size as f64 / 2.0 - ((index / size) as f64 + 0.5);
            count += 1.0;
        }
    }
    [u / count, v / count]
}

/// A mirrored picture passes every other test: a flip is an element of the group, so networks would
/// not notice.
#[test]
fn known_points_are_drawn_at_their_projections_under_every_element() {
    for (height, half_extent, size) in [(1.5, 0.44, 128), (0.9, 0.6, 96)] {
        let camera = Camera { size, height, half_extent, ..Camera::default() };
        for g in D2::ALL {
            let rgb = draw_points(&camera, g);
            for ([x, y, z], channel) in POINTS {
                let [x, y] = g.apply_xy([x, y]);
                let [u, v] = camera.project(DVec3::new(x, y, z));
                let [drawn_u, drawn_v] = centroid(&rgb, size, channel);
                let off = (drawn_u - u).hypot(drawn_v - v);
                assert!(off < 0.75, "{g}: {off} pixels off");
            }
        }
    }
}
