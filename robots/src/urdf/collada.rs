//! Points of a COLLADA file (`.dae`).
//!
//! Like ROS, this heeds the file's unit and the transforms of its nodes, and not its `<up_axis>`.

use std::collections::HashMap;

use glam::{DAffine3, DMat4, DQuat, DVec3};
use roxmltree::{Document, Node, ParsingOptions};

use super::xml::MAX_NODES;

/// Maximum number of points, since a file may place a geometry many times.
const MAX_POINTS: usize = 1 << 24;
/// Maximum number of nodes around a geometry.
const MAX_NESTED: usize = 64;

/// Returns the points (metres) of all geometries where the scene places them.
pub(super) fn points(text: &str) -> Result<Vec<DVec3>, String> {
    let options = ParsingOptions { allow_dtd: true, nodes_limit: MAX_NODES, ..Default::default() };
    let parsed = Document::parse_with_options(text, options);
    let document = parsed.map_err(|error| format!("it is not COLLADA: broken XML, {error}"))?;
    let all = || document.descendants();
    let unit = all().find_map(|node| node.attribute("meter")?.trim().parse().ok()).unwrap_or(1.0);
    let geometries = all().filter(|node| is(node, "geometry"));
    let geometries: HashMap<&str, Vec<DVec3>> =
        geometries.filter_map(|node| Some((node.attribute("id")?, positions(node)?))).collect();
    let mut points = Vec::new();
    for instance in all().filter(|node| is(node, "instance_geometry")) {
        let url = instance.attribute("url").and_then(|url| url.strip_prefix('#'));
        let Some(geometry) = url.and_then(|url| geometries.get(url)) else {
            continue;
        };
        if points.len() + geometry.len() > MAX_POINTS {
            return Err("it has more than 16 million points".to_owned());
        }
        let nodes = instance.ancestors().skip(1).take(MAX_NESTED).take_while(|n| is(n, "node"));
        let pose = nodes.fold(DAffine3::IDENTITY, |pose, node| transform(node) * pose);
        points.extend(geometry.iter().map(|&point| unit * pose.transform_point3(point)));
    }
    Ok(points)
}

fn is(node: &Node, name: &str) -> bool {
    node.tag_name().name() == name
}

/// Returns the points of a geometry; `None` if it has none.
fn positions(geometry: Node) -> Option<Vec<DVec3>> {
    let vertices = geometry.descendants().find(|node| is(node, "vertices"))?;
    let input = vertices.children().find(|node| node.attribute("semantic") == Some("POSITION"))?;
    let source = input.attribute("source")?.strip_prefix('#')?;
    let source = geometry.descendants().find(|node| node.attribute("id") == Some(source))?;
    let accessor = source.descendants().find(|node| is(node, "accessor"))?;
    let stride = accessor.attribute("stride").map_or(Some(3), |stride| stride.parse().ok())?;
    let floats = source.descendants().find(|node| is(node, "float_array"))?;
    let numbers = numbers(floats);
    let point = |point: &[f64]| Some(DVec3::from_array(*point.first_chunk()?));
    Some(numbers.chunks(stride.max(3)).filter_map(point).collect())
}

/// Returns the transform of a node's points to those of the node around it.
fn transform(node: Node) -> DAffine3 {
    let steps = node.children().filter(Node::is_element).map(|step| {
        let numbers = numbers(step);
        match (step.tag_name().name(), &numbers[..]) {
            ("translate", &[x, y, z]) => DAffine3::from_translation(DVec3::new(x, y, z)),
            ("scale", &[x, y, z]) => DAffine3::from_scale(DVec3::new(x, y, z)),
            ("rotate", &[x, y, z, degrees]) => {
                let axis = DVec3::new(x, y, z).normalize_or(DVec3::X);
                DAffine3::from_quat(DQuat::from_axis_angle(axis, degrees.to_radians()))
            }
            ("matrix", rows) => rows.try_into().map_or(DAffine3::IDENTITY, |rows: &[f64; 16]| {
                DAffine3::from_mat4(DMat4::from_cols_array(rows).transpose())
            }),
            _ => DAffine3::IDENTITY,
        }
    });
    steps.fold(DAffine3::IDENTITY, |all, step| all * step)
}

/// Returns the numbers in an element's text.
fn numbers(element: Node) -> Vec<f64> {
    let words = element.text().unwrap_or_default().split_whitespace();
    words.filter_map(|word| word.parse().ok()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_lie_where_the_scene_puts_them() {
        let geometry = r##"<?xml version="1.0"?>
            <COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
            <asset><unit meter="0.01"/><up_axis>Y_UP</up_axis></asset>
            <library_geometries><geometry id="g"><mesh>
            <source id="n"><float_array>9 9 9</float_array></source>
            <source id="p"><float_array count="8">1 2 3 0 4 5 6 0</float_array><technique_common>
            <accessor source="#f" count="2" stride="4"/></technique_common></source>
            <vertices id="v"><input semantic="NORMAL" source="#n"/>
            <input semantic="POSITION" source="#p"/></vertices></mesh></geometry></library_geometries>
            <library_visual_scenes><visual_scene id="s">"##;
        for (nodes, expected) in [
            ("<node>G</node>", [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]),
            (
                "<node><translate>10 0 0</translate><node><scale>1 1 2</scale>G</node></node>",
                [[11.0, 2.0, 6.0], [14.0, 5.0, 12.0]],
            ),
            (
                "<node><rotate>0 0 1 90</rotate><translate>1 0 0</translate>G</node>",
                [[-2.0, 2.0, 3.0], [-5.0, 5.0, 6.0]],
            ),
            (
                "<node><matrix>0 -1 0 7 1 0 0 0 0 0 1 0 0 0 0 1</matrix>G</node>",
                [[5.0, 1.0, 3.0], [2.0, 4.0, 6.0]],
            ),
        ] {
            let nodes = nodes.replace('G', "<instance_geometry url=\"#g\"/>");
            let text =
                format!("{geometry}{nodes}</visual_scene></library_visual_scenes></COLLADA>");
            let found = points(&text).unwrap();
            assert_eq!(found.len(), 2);
            for (found, expected) in found.iter().zip(expected) {
                let off = found.distance(0.01 * DVec3::from_array(expected));
                assert!(off < 1e-12, "{found} {expected:?}");
            }
        }
        assert_eq!(points("<COLLADA/>").unwrap(), []);
    }
}
