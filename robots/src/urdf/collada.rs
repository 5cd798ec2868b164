//! Points of a COLLADA file (`.dae`).
//!
//! Follows the file's scene: nodes with their transforms, nodes that are instances of others, and
//! their geometries. The file's unit is heeded. Its `<up_axis>` is not: RViz, Gazebo and pinocchio
//! ignore it, so the frames of real URDFs fit meshes without it. Whatever else may place or bend
//! points is an error.

use std::collections::HashMap;
use std::str::FromStr;

use glam::{DAffine3, DMat4, DQuat, DVec3};
use roxmltree::Node;

use super::xml::parse;

/// Maximum number of nested nodes.
const MAX_NESTED: usize = 64;
/// Maximum number of nodes and numbers that are read, since a file may place a geometry many times.
const MAX_READ: usize = 1 << 25;

/// Returns the points (metres) of all geometries of a COLLADA file, where its scene places them,
/// and a note if the file has another up axis than z.
pub(super) fn points(text: &str) -> Result<(Vec<DVec3>, Option<&'static str>), String> {
    let found = parse(text, "COLLADA", |root| {
        let unit = unit(root)?;
        let scene = child(child(root, "scene")?, "instance_visual_scene")?;
        let mut reader = Reader::new(root);
        reader.add(reader.target(scene, "url", "visual_scene")?, DAffine3::from_scale(unit), 0)?;
        let up = child(root, "asset").and_then(|asset| child(asset, "up_axis")).ok();
        let is_up = up.is_none_or(|up| up.text().unwrap_or_default().trim() == "Z_UP");
        let note = "the `<up_axis>` of COLLADA meshes is ignored, as in RViz and Gazebo";
        Ok((reader.points, (!is_up).then_some(note)))
    });
    found.flatten().map_err(|reason| format!("it cannot be read as COLLADA: {reason}"))
}

/// Returns the length of the file's unit (metres), as a scale.
fn unit(root: Node) -> Result<DVec3, String> {
    let metres = |stated: &str| match stated.trim().parse::<f64>() {
        Ok(metres) if metres > 0.0 => Ok(metres),
        _ => Err(format!("its unit is {stated:?} m, expected a positive number")),
    };
    let own = child(root, "asset").and_then(|asset| child(asset, "unit")).ok();
    let own = own.and_then(|unit| unit.attribute("meter")).map_or(Ok(1.0), metres)?;
    for stated in root.descendants().filter_map(|unit| unit.attribute("meter")) {
        let other = metres(stated)?;
        if other != own {
            return Err(format!("it has units of {own} m and {other} m, expected one"));
        }
    }
    Ok(DVec3::splat(own))
}

/// Reader of the nodes of a file.
struct Reader<'a> {
    /// Elements by name and id; `None` if two have the same.
    elements: HashMap<(&'a str, &'a str), Option<Node<'a, 'a>>>,
    points: Vec<DVec3>,
    /// Number of nodes and numbers read.
    read: usize,
}

impl<'a> Reader<'a> {
    fn new(root: Node<'a, 'a>) -> Self {
        let mut elements = HashMap::new();
        for node in root.descendants() {
            if let Some(id) = node.attribute("id") {
                let entry = elements.entry((node.tag_name().name(), id));
                entry.and_modify(|found| *found = None).or_insert(Some(node));
            }
        }
        Self { elements, points: Vec::new(), read: 0 }
    }

    /// Returns the element `name` to which an attribute of a node refers.
    fn target(&self, node: Node, attribute: &str, name: &str) -> Result<Node<'a, 'a>, String> {
        let stated = node.attribute(attribute).unwrap_or_default();
        let id = stated.strip_prefix('#').unwrap_or_default();
        let found = self.elements.get(&(name, id)).copied().flatten();
        found.ok_or_else(|| {
            let tag = node.tag_name().name();
            format!(
                "`{attribute}` of `<{tag}>` is {stated:?}, expected # and the id of one `<{name}>`"
            )
        })
    }

    /// Adds the points of a node, or of a scene, whose frame is `around`.
    fn add(&mut self, node: Node<'a, 'a>, around: DAffine3, depth: usize) -> Result<(), String> {
        if depth > MAX_NESTED {
            return Err(format!("more than {MAX_NESTED} nodes are inside each other"));
        }
        self.count(1)?;
        let mut pose = around;
        for step in node.children() {
            pose *= transform(step)?.unwrap_or(DAffine3::IDENTITY);
        }
        for inside in node.children().filter(Node::is_element) {
            match inside.tag_name().name() {
                "node" => self.add(inside, pose, depth + 1)?,
                "instance_node" => {
                    self.add(self.target(inside, "url", "node")?, pose, depth + 1)?;
                }
                "instance_geometry" => {
                    let own = self.positions(self.target(inside, "url", "geometry")?)?;
                    self.points.extend(own.into_iter().map(|point| pose.transform_point3(point)));
                }
                "translate" | "rotate" | "scale" | "matrix" => (),
                "asset" | "extra" | "evaluate_scene" | "instance_camera" | "instance_light" => (),
                other => return Err(format!("`<{other}>` in a node is not supported")),
            }
        }
        Ok(())
    }

    /// Returns the points of a geometry that its surfaces use.
    fn positions(&mut self, geometry: Node<'a, 'a>) -> Result<Vec<DVec3>, String> {
        let mesh = child(geometry, "mesh")?;
        let vertices = child(mesh, "vertices")?;
        let source = self.target(input(vertices, "POSITION")?, "source", "source")?;
        let all = self.points_of(source)?;
        let mut used = vec![false; all.len()];
        for primitive in mesh.children().filter(Node::is_element) {
            match primitive.tag_name().name() {
                "triangles" | "polylist" | "polygons" | "tristrips" | "trifans" => (),
                // lines have no surface
                "source" | "vertices" | "lines" | "linestrips" | "extra" => continue,
                other => return Err(format!("`<{other}>` in a mesh is not supported")),
            }
            let vertex = input(primitive, "VERTEX")?;
            if self.target(vertex, "source", "vertices")? != vertices {
                return Err("a surface uses the `<vertices>` of another mesh".to_owned());
            }
            let inputs = primitive.children().filter(|child| child.has_tag_name("input"));
            let offsets = inputs.map(|input| index(input, "offset", "0"));
            let stride = offsets.collect::<Result<Vec<_>, _>>()?.into_iter().max().unwrap_or(0) + 1;
            // polygons with holes have their indices in `<ph>` and `<h>`
            let lists = primitive.descendants();
            for list in lists.filter(|list| list.has_tag_name("p") || list.has_tag_name("h")) {
                let indices: Vec<usize> = numbers(list)?;
                self.count(indices.len())?;
                for &at in indices.iter().skip(index(vertex, "offset", "0")?).step_by(stride) {
                    let points = all.len();
                    let used = used.get_mut(at);
                    *used.ok_or_else(|| format!("a surface uses point {at} of {points}"))? = true;
                }
            }
        }
        Ok(all.into_iter().zip(used).filter_map(|(point, used)| used.then_some(point)).collect())
    }

    /// Returns all points of a `<source>`.
    fn points_of(&mut self, source: Node<'a, 'a>) -> Result<Vec<DVec3>, String> {
        let accessor = child(child(source, "technique_common")?, "accessor")?;
        let params = accessor.children().filter(Node::is_element);
        let params: Vec<_> = params.map(|param| param.attribute("name")).collect();
        if !params.starts_with(&[Some("X"), Some("Y"), Some("Z")]) {
            return Err(format!("points have the coordinates {params:?}, expected X, Y, Z"));
        }
        let count = index(accessor, "count", "")?;
        let stride = index(accessor, "stride", "1")?;
        let offset = index(accessor, "offset", "0")?;
        let numbers: Vec<f64> = numbers(self.target(accessor, "source", "float_array")?)?;
        self.count(numbers.len())?;
        let points = numbers.get(offset..).unwrap_or_default().chunks(stride.max(1));
        let points = points.filter_map(|point| Some(DVec3::from_array(*point.first_chunk()?)));
        let points: Vec<DVec3> = points.take(count).collect();
        if points.len() == count && stride >= 3 {
            return Ok(points);
        }
        let found = numbers.len();
        Err(format!("{count} points of {stride} numbers each are not in {found} numbers"))
    }

    fn count(&mut self, read: usize) -> Result<(), String> {
        self.read += read;
        let is_long = self.read > MAX_READ;
        if is_long { Err(format!("it places more than {MAX_READ} numbers")) } else { Ok(()) }
    }
}

fn child<'a>(node: Node<'a, 'a>, name: &str) -> Result<Node<'a, 'a>, String> {
    let found = node.children().find(|child| child.has_tag_name(name));
    found.ok_or_else(|| format!("`<{}>` has no `<{name}>`", node.tag_name().name()))
}

/// Returns the transform that an element of a node states; `None` for other elements.
fn transform(step: Node) -> Result<Option<DAffine3>, String> {
    let name = step.tag_name().name();
    if !["translate", "rotate", "scale", "matrix"].contains(&name) {
        return Ok(None);
    }
    let stated: Vec<f64> = numbers(step)?;
    let transform = match (name, &stated[..]) {
        ("translate", &[x, y, z]) => Some(DAffine3::from_translation(DVec3::new(x, y, z))),
        ("scale", &[x, y, z]) => Some(DAffine3::from_scale(DVec3::new(x, y, z))),
        ("rotate", &[x, y, z, degrees]) => DVec3::new(x, y, z)
            .try_normalize()
            .map(|axis| DAffine3::from_quat(DQuat::from_axis_angle(axis, degrees.to_radians()))),
        ("matrix", &[.., 0.0, 0.0, 0.0, 1.0]) => <&[f64; 16]>::try_from(&stated[..])
            .ok()
            .map(|rows| DAffine3::from_mat4(DMat4::from_cols_array(rows).transpose())),
        _ => None,
    };
    transform.map(Some).ok_or_else(|| format!("`<{name}>` of a node is {stated:?}"))
}

/// Returns the `<input>` of an element that has a meaning, such as `POSITION`.
fn input<'a>(of: Node<'a, 'a>, semantic: &str) -> Result<Node<'a, 'a>, String> {
    let found = of.children().find(|input| input.attribute("semantic") == Some(semantic));
    found.ok_or_else(|| format!("`<{}>` has no input {semantic}", of.tag_name().name()))
}

fn index(node: Node, attribute: &str, default: &str) -> Result<usize, String> {
    let (name, stated) = (node.tag_name().name(), node.attribute(attribute).unwrap_or(default));
    let expected = "expected a whole number";
    stated.parse().map_err(|_| format!("`{attribute}` of `<{name}>` is {stated:?}, {expected}"))
}

/// Returns the numbers in an element's text.
fn numbers<T: FromStr>(element: Node) -> Result<Vec<T>, String> {
    let texts = element.children().filter_map(|child| child.text().filter(|_| child.is_text()));
    let text: String = texts.collect();
    let name = element.tag_name().name();
    let number = |word: &str| {
        word.parse().map_err(|_| format!("`<{name}>` holds {word:?}, expected numbers alone"))
    };
    text.split_whitespace().map(number).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A file of a geometry, which `G` places in `nodes`: a surface through (1, 2, 3) and
    /// (4, 5, 6), and another point.
    fn file(nodes: &str) -> String {
        let [geometry, more] = ["g", "h"].map(|id| {
            format!(
                "<geometry id='{id}'><mesh><source id='n{id}'><float_array id='a'>9 9</float_array>
                </source><source id='p{id}'><float_array id='a{id}'>7 1 2 3 0 8 8 8 0 4 <!-- --> 5
                6 0</float_array><technique_common><accessor source='#a{id}' count='3' stride='4'
                offset='1'><param name='X'/><param name='Y'/><param name='Z'/><param/></accessor>
                </technique_common></source><vertices id='v{id}'>
                <input semantic='NORMAL' source='#n{id}'/><input semantic='POSITION' source='#p{id}'/></vertices><polygons>
                <input semantic='VERTEX' source='#v{id}' offset='1'/><input offset='2'/>
                <p>9 0 9 9 2 9</p><ph><p>9 0 9</p><h>9 2 9</h></ph></polygons><lines><p>1 1</p></lines></mesh>
                </geometry>"
            )
        });
        let nodes = nodes.replace('G', "<instance_geometry url='#g'/>");
        format!(
            "<!DOCTYPE COLLADA><COLLADA xmlns='c'>
            <asset><unit meter='0.01'/><up_axis>Z_UP</up_axis></asset>
            <library_geometries>{geometry}{more}</library_geometries><library_nodes>
            <node id='far'><translate>100 0 0</translate><instance_geometry url='#g'/></node>
            <node id='round'><instance_node url='#round'/></node></library_nodes>
            <library_visual_scenes><visual_scene id='other'><node>
            <instance_geometry url='#h'/></node></visual_scene><visual_scene id='s'>{nodes}</visual_scene></library_visual_scenes>
            <scene><instance_visual_scene url='#s'/></scene></COLLADA>"
        )
    }

    #[test]
    fn points_lie_where_the_scene_puts_them() {
        for (node, [x, y, z]) in [
            ("G", [4.0, 5.0, 6.0]),
            ("<translate>9 0 0</translate><node><scale>1 1 2</scale>G</node>", [13.0, 5.0, 12.0]),
            ("<scale>1 1 2</scale><node><translate>0 0 9</translate>G</node>", [4.0, 5.0, 30.0]),
            ("<rotate>0 0 2 90</rotate><translate>1 0 0</translate>G", [-5.0, 5.0, 6.0]),
            ("<translate>1 0 0</translate><rotate>0 0 1 90</rotate>G", [-4.0, 4.0, 6.0]),
            ("<matrix>0 -1 0 7 1 0 0 0 0 0 1 0 0 0 0 1</matrix>G", [2.0, 4.0, 6.0]),
            ("<scale>-1 1 1</scale><instance_node url='#far'/>", [-104.0, 5.0, 6.0]),
            ("<instance_camera url='#c'/><extra/><node/>G", [4.0, 5.0, 6.0]),
        ] {
            let (found, note) = points(&file(&format!("<node>{node}</node>"))).unwrap();
            assert_eq!((found.len(), note), (2, None));
            assert!(found[1].distance(0.01 * DVec3::new(x, y, z)) < 1e-12, "{node} {found:?}");
        }
        assert_eq!(points(&file("<node>GG</node><node>G</node>")).unwrap().0.len(), 6);
        assert_eq!(points(&file("<node/>")).unwrap().0, []);
    }

    #[test]
    fn units_are_heeded_and_up_axes_noted() {
        let whole = file("<node>G</node>");
        for (old, new, x, is_noted) in [
            ("<unit meter='0.01'/>", "", 1.0, false),
            ("<unit meter='0.01'/>", "<unit name='m' meter=' 2e0 '/>", 2.0, false),
            ("<up_axis>Z_UP</up_axis>", "", 0.01, false),
            ("Z_UP", "Y_UP", 0.01, true),
        ] {
            let (found, note) = points(&whole.replace(old, new)).unwrap();
            assert!(
                (found[0].x - x).abs() < 1e-12 && note.is_some() == is_noted,
                "{new} {found:?}"
            );
        }
    }

    #[test]
    fn files_that_could_give_wrong_shapes_are_refused() {
        let whole = file("<node><translate>1 0 0</translate>G</node>");
        for (old, new, words) in [
            (
                "<instance_geometry url='#g'/></node></v",
                "<instance_controller/></node></v",
                "`<instance_c",
            ),
            ("<translate>1 0 0</translate>", "<lookat>1</lookat>", "`<lookat>` in a node"),
            ("<translate>1 0 0</translate>", "<skew>1</skew>", "`<skew>` in a node"),
            ("<translate>1 0 0</translate>", "<translate>1 0</translate>", "[1.0, 0.0]"),
            ("<translate>1 0 0</translate>", "<translate>1 0 0,5</translate>", "\"0,5\""),
            ("<translate>1 0 0</translate>", "<rotate>0 0 0 9</rotate>", "`<rotate>` of a node"),
            (
                "<translate>1 0 0</translate>",
                "<matrix>1 0 0 0 0 1 0 0 0 0 1 0 0 0 1 1</matrix>",
                "`<matrix>` of a node",
            ),
            ("<translate>1 0 0</translate>", "<instance_node url='#round'/>", "more than 64 nodes"),
            ("<translate>1 0 0</translate>", "<instance_node url='a.dae#far'/>", "\"a.dae#far\""),
            ("<translate>1 0 0</translate>", "<instance_node/>", "the id of one `<node>`"),
            ("url='#g'", "url='#none'", "the id of one `<geometry>`"),
            ("id='h'", "id='g'", "the id of one `<geometry>`"),
            ("<instance_visual_scene url='#s'/>", "", "`<scene>` has no `<instance_visual_scene>`"),
            ("mesh>", "convex_mesh>", "`<geometry>` has no `<mesh>`"),
            ("meter='0.01'", "meter='1 cm'", "\"1 cm\" m"),
            ("meter='0.01'", "meter='-1'", "\"-1\" m"),
            (
                "<visual_scene id='s'>",
                "<visual_scene id='s'><asset><unit meter='1'/></asset>",
                "0.01 m and 1 m",
            ),
            (
                "<unit meter='0.01'/><up_axis>Z_UP</up_axis></asset>",
                "<unit/></asset><unit meter='0.01'/>",
                "1 m and 0.01 m",
            ),
            ("name='Y'", "name='Z'", "expected X, Y, Z"),
            ("count='3'", "count='4'", "4 points of 4 numbers each"),
            ("stride='4'", "", "3 points of 1 numbers each"),
            ("stride='4'", "stride='-4'", "`stride` of `<accessor>` is \"-4\""),
            ("<p>9 0 9 9 2 9", "<p>9 0 9 9 3 9", "uses point 3 of 3"),
            ("<h>9 2 9</h>", "<h>9 -1 9</h>", "`<h>` holds \"-1\""),
            ("lines>", "splines>", "`<splines>` in a mesh"),
            ("'VERTEX' source='#vg'", "'VERTEX' source='#vh'", "`<vertices>` of another mesh"),
            ("'VERTEX'", "'NORMAL'", "`<polygons>` has no input VERTEX"),
            ("7 1 2 3 0", "7 1 2 3 x", "\"x\", expected numbers"),
            ("source='#ag'", "source='#an'", "the id of one `<float_array>`"),
            ("semantic='POSITION'", "semantic='TEXCOORD'", "has no input POSITION"),
            ("<!DOCTYPE COLLADA>", "<!DOCTYPE COLLADA [<!ENTITY a 'b'>]>", "entities are not read"),
        ] {
            assert!(whole.contains(old), "{old}");
            let error = points(&whole.replace(old, new)).unwrap_err();
            assert!(error.contains(words), "{new}: {error}");
        }
        assert!(points("<a/>").unwrap_err().contains("`<COLLADA>`"));
    }
}
