//! Points of a COLLADA file (`.dae`).
//!
//! Like ROS, this heeds the file's unit and the transforms of its nodes, and not its `<up_axis>`.

use std::collections::HashMap;

use glam::{DAffine3, DMat4, DQuat, DVec3};
use roxmltree::{Document, Node};

use super::xml::options;

/// Maximum number of points, since a file may place a geometry many times.
const MAX_POINTS: usize = 1 << 24;
/// Maximum number of nodes around a geometry.
const MAX_NESTED: usize = 64;

/// Returns the points (metres) of all geometries where the scene places them.
pub(super) fn points(text: &str) -> Result<Vec<DVec3>, String> {
    let parsed = Document::parse_with_options(text, options());
    let document = parsed.map_err(|error| format!("it is not COLLADA: broken XML, {error}"))?;
    let all = || document.descendants();
    let ids: HashMap<&str, Node> =
        all().filter_map(|node| Some((node.attribute("id")?, node))).collect();
    let unit = all().find_map(|node| node.attribute("meter")?.trim().parse().ok()).unwrap_or(1.0);
    let mut points = Vec::new();
    for instance in all().filter(|node| node.has_tag_name("instance_geometry")) {
        let around = instance.ancestors().skip(1).take(MAX_NESTED);
        let pose = around.fold(DAffine3::IDENTITY, |pose, node| transform(node) * pose);
        let own = positions(instance, &ids).unwrap_or_default();
        points.extend(own.into_iter().map(|point| unit * pose.transform_point3(point)));
        if points.len() > MAX_POINTS {
            return Err("it has more than 16 million points".to_owned());
        }
    }
    Ok(points)
}

fn inside<'a>(node: Node<'a, 'a>, name: &str) -> Option<Node<'a, 'a>> {
    node.descendants().find(|node| node.has_tag_name(name))
}

/// Returns the points of the geometry that an instance is `of`; `None` if it has none.
fn positions<'a>(of: Node<'a, 'a>, ids: &HashMap<&str, Node<'a, 'a>>) -> Option<Vec<DVec3>> {
    let target = |node: Node, url| ids.get(node.attribute(url)?.strip_prefix('#')?).copied();
    let vertices = inside(target(of, "url")?, "vertices")?;
    let input = vertices.children().find(|node| node.attribute("semantic") == Some("POSITION"))?;
    let source = target(input, "source")?;
    let stride = inside(source, "accessor")?.attribute("stride").unwrap_or("3").parse().ok()?;
    let numbers = numbers(inside(source, "float_array")?);
    let point = |point: &[f64]| Some(DVec3::from_array(*point.first_chunk()?));
    Some(numbers.chunks(3.max(stride)).filter_map(point).collect())
}

/// Returns the transform of a node's points to those of the node around it.
fn transform(node: Node) -> DAffine3 {
    let steps = node.children().filter(|_| node.has_tag_name("node")).map(|step| {
        match (step.tag_name().name(), &numbers(step)[..]) {
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
        for (nodes, [x, y, z]) in [
            ("G", [4.0, 5.0, 6.0]),
            ("<translate>9 0 0</translate><node><scale>1 1 2</scale>G</node>", [13.0, 5.0, 12.0]),
            ("<rotate>0 0 1 90</rotate><translate>1 0 0</translate>G", [-5.0, 5.0, 6.0]),
            ("<matrix>0 -1 0 7 1 0 0 0 0 0 1 0 0 0 0 1</matrix>G", [2.0, 4.0, 6.0]),
        ] {
            let nodes = nodes.replace('G', "<instance_geometry url='#g'/>");
            let text = format!(
                "<COLLADA xmlns='c'><unit meter='0.01'/><up_axis>Y_UP</up_axis><geometry id='g'>
                <source id='n'><float_array>9 9 9</float_array></source><source id='p'>
                <float_array>1 2 3 0 4 5 6 0</float_array><accessor stride='4'/></source><vertices>
                <input semantic='NORMAL' source='#n'/><input semantic='POSITION' source='#p'/>
                </vertices></geometry><node>{nodes}</node></COLLADA>"
            );
            let found = points(&text).unwrap();
            assert_eq!(found.len(), 2);
            assert!(found[1].distance(0.01 * DVec3::new(x, y, z)) < 1e-12, "{found:?}");
        }
        assert_eq!(points("<COLLADA/>").unwrap(), []);
    }
}
