//! Collision meshes: where they are found, and which are refused.

use std::collections::BTreeMap;
use std::fs;
use std::path::PathBuf;

use robots::{DescriptionError, MjcfSettings, PlacedShape, RobotDescription, Shape, UrdfSettings};

use crate::SIX_JOINT;

/// Temporary folder that is removed when the test ends.
pub struct Folder(PathBuf);

impl Folder {
    pub fn new(name: &str) -> Self {
        let folder = std::env::temp_dir().join(format!("covers-{name}-{}", std::process::id()));
        fs::create_dir_all(&folder).unwrap();
        Self(folder.canonicalize().unwrap())
    }

    pub fn write(&self, file: &str, text: &[u8]) {
        let path = self.0.join(file);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, text).unwrap();
    }

    pub fn read_with(
        &self,
        urdf: &str,
        settings: &UrdfSettings,
    ) -> Result<RobotDescription, DescriptionError> {
        let file = "arm_description/urdf/arm.urdf";
        self.write(file, urdf.as_bytes());
        RobotDescription::from_urdf_file_with_settings(&self.0.join(file), settings)
    }

    /// The six-jointed arm whose carriage collides as the mesh `file`.
    fn try_mesh(
        &self,
        file: &str,
        settings: &UrdfSettings,
    ) -> Result<RobotDescription, DescriptionError> {
        let mesh = format!("<mesh filename=\"{file}\" scale=\"0.001 0.001 0.001\"/>");
        let urdf = SIX_JOINT.replace("<sphere radius=\"0.05\"/>", &mesh);
        self.read_with(&urdf, settings)
    }

    #[track_caller]
    fn with_mesh(&self, file: &str, settings: &UrdfSettings) -> RobotDescription {
        self.try_mesh(file, settings).unwrap()
    }

    fn settings(&self) -> UrdfSettings {
        UrdfSettings { mesh_root: Some(self.0.clone()), ..UrdfSettings::default() }
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

/// An octahedron whose corners are this far from its middle.
fn octahedron(radius: f64) -> Vec<u8> {
    let vertex = |[x, y, z]: [f64; 3]| format!("v {x} {y} {z}\n");
    let r = radius;
    let corners = [[r, 0.0, 0.0], [0.0, r, 0.0], [0.0, 0.0, r]];
    let opposite = corners.map(|corner| corner.map(|number| -number));
    corners.into_iter().chain(opposite).map(vertex).collect::<String>().into_bytes()
}

/// The radius (millimetres) of the sphere around the mesh of the carriage.
#[track_caller]
fn radius(arm: &RobotDescription) -> f64 {
    let shapes = &arm.links()[2].shapes[..];
    let [PlacedShape { shape: Shape::Hull(hull), pose }] = shapes else {
        panic!("{shapes:?} {:?}", arm.missing_shape_reasons());
    };
    assert!(pose.position.x == 0.1 && hull.points().len() == 6, "{shapes:?}");
    (1e3 * hull.points()[0].length()).round()
}

#[test]
fn meshes_are_found_in_their_packages() {
    let (folder, other) = (Folder::new("meshes"), Folder::new("elsewhere"));
    for file in ["arm_description/meshes/ball.obj", "hand_description/ball.OBJ"] {
        folder.write(file, &octahedron(50.0));
    }
    other.write("far/ball.obj", &octahedron(50.0));
    let packages = BTreeMap::from([("far_description".to_owned(), other.0.join("far"))]);
    let settings = UrdfSettings { packages, ..folder.settings() };
    let absolute = format!("file://{}/arm_description/meshes/ball.obj", folder.0.display());
    for (name, notes) in [
        ("package://arm_description/meshes/ball.obj", 0),
        ("package://renamed_description/meshes/ball.obj", 1),
        ("package://hand_description/ball.OBJ", 0),
        ("package://far_description/ball.obj", 0),
        ("model://arm_description/meshes/ball.obj", 0),
        ("../meshes/ball.obj", 0),
        ("..\\meshes\\ball.obj", 0),
        (&absolute, 0),
    ] {
        let arm = folder.with_mesh(name, &settings);
        assert_eq!(radius(&arm), 50.0, "{name}");
        assert_eq!(arm.import_notes().len(), notes, "{:?}", arm.import_notes());
    }
}

/// The packages of the settings are the only choice. Else folders of the package's name come first,
/// then those whose `package.xml` has it, and last, with a note, those that are no package.
#[test]
fn the_folder_of_a_package_is_chosen_in_a_fixed_order() {
    let folder = Folder::new("order");
    let mesh = "package://hand/meshes/ball.obj";
    let xml = |name: &str| format!("<package><!-- - --><name> {name} </name></package>");
    // the folders around the URDF, which are not those of the package
    folder.write("arm_description/urdf/meshes/ball.obj", &octahedron(10.0));
    folder.write("arm_description/meshes/ball.obj", &octahedron(20.0));
    let radius_with = |settings: &UrdfSettings| {
        let arm = folder.with_mesh(mesh, settings);
        (radius(&arm), arm.import_notes().len())
    };
    assert_eq!(radius_with(&folder.settings()), (10.0, 1));
    folder.write("arm_description/urdf/package.xml", xml("legs").as_bytes());
    assert_eq!(radius_with(&folder.settings()), (20.0, 1));
    folder.write("arm_description/package.xml", xml("hand").as_bytes());
    assert_eq!(radius_with(&folder.settings()), (20.0, 0));
    folder.write("hand/meshes/ball.obj", &octahedron(30.0));
    assert_eq!(radius_with(&folder.settings()), (30.0, 0));
    folder.write("mine/meshes/ball.obj", &octahedron(40.0));
    let mapped = |mine: &str| {
        let packages = BTreeMap::from([("hand".to_owned(), folder.0.join(mine))]);
        UrdfSettings { packages, ..folder.settings() }
    };
    assert_eq!(radius_with(&mapped("mine")), (40.0, 0));
    // the file is nowhere else than in the folder of the settings
    let error = folder.try_mesh(mesh, &mapped("mine/meshes")).unwrap_err().to_string();
    let tried = folder.0.join("mine/meshes/meshes/ball.obj");
    assert!(error.contains(&format!("no such file, tried `{}`;", tried.display())), "{error}");
    assert!(error.starts_with("line ") && error.contains("the link `carriage`"), "{error}");
    // nothing but a folder of another package is left
    fs::remove_file(folder.0.join("hand/meshes/ball.obj")).unwrap();
    folder.write("arm_description/package.xml", xml("arm").as_bytes());
    let arm = folder.with_mesh(mesh, &folder.settings());
    assert!(
        arm.missing_shape_reasons()[0].contains("/hand/meshes/ball.obj`"),
        "{:?}",
        arm.missing_shape_reasons()
    );
}

#[test]
fn folders_of_the_settings_must_exist() {
    let folder = Folder::new("settings");
    folder.write("file", b"");
    for missing in ["none", "file"] {
        let path = folder.0.join(missing);
        let packages = BTreeMap::from([("hand".to_owned(), path.clone())]);
        let ignore_meshes = true;
        for (settings, name) in [
            (
                UrdfSettings { packages, ignore_meshes, ..UrdfSettings::default() },
                "UrdfSettings::packages[\"hand\"]",
            ),
            (
                UrdfSettings { mesh_root: Some(path.clone()), ..UrdfSettings::default() },
                "UrdfSettings::mesh_root",
            ),
        ] {
            let error = folder.read_with(SIX_JOINT, &settings).unwrap_err().to_string();
            let expected = format!("`{name}` is `{}`, which is not a folder", path.display());
            assert!(error.contains(&expected), "{error}");
        }
    }
}

/// A mesh that cannot be read is reported with every path that was tried, and missed where shapes
/// are needed.
#[test]
fn meshes_that_cannot_be_read_are_named() {
    let (folder, other) = (Folder::new("unread"), Folder::new("outside"));
    other.write("ball.obj", b"v 1 2 3");
    for (file, text) in [
        ("far.obj", &b"v 1 2 2e9"[..]),
        ("nan.obj", b"v 1 2 3\nv 1 nan 3"),
        ("inf.obj", b"v 1 2 -inf"),
        ("ball.ply", b"ply"),
        ("page.obj", b"<html>"),
    ] {
        folder.write(&format!("arm_description/{file}"), text);
    }
    let link = folder.0.join("link.obj");
    std::os::unix::fs::symlink(other.0.join("ball.obj"), link).unwrap();
    let settings = folder.settings();
    let outside = format!("file://{}/ball.obj", other.0.display());
    for (file, words) in [
        ("none.obj", "urdf/none.obj`; correct its `filename`"),
        ("package://arm_description/none.obj", "arm_description/arm_description/none.obj`, `"),
        ("../far.obj", "its point [0.001, 0.002, 2000000], as scaled, is not within 1e6 m"),
        ("../nan.obj", "its point [0.001, NaN, 0.003], as scaled, is not within 1e6 m"),
        ("../inf.obj", "-inf], as scaled"),
        ("../ball.ply", "only STL, OBJ and DAE"),
        ("../page.obj", "no line of it starts with `v`"),
        ("https://host/a.stl", "`https://` is not read"),
        ("../../link.obj", "and no file there is read"),
        (&outside, "and no file there is read"),
    ] {
        let arm = folder.with_mesh(file, &settings);
        let message = arm.to_mjcf(&MjcfSettings::default()).unwrap_err().to_string();
        assert!(arm.links()[2].shapes.is_empty());
        assert!(message.contains(words) && message.contains("ignore_meshes"), "{message}");
        assert!(message.contains(&format!("link `carriage` collides as the mesh `{file}`")));
        let ignored = UrdfSettings { ignore_meshes: true, ..settings.clone() };
        let without = folder.with_mesh(file, &ignored);
        without.to_mjcf(&MjcfSettings::default()).unwrap();
        let is_named = |note: &String| note.contains(file) && note.contains("is ignored");
        assert!(without.import_notes().iter().any(is_named), "{:?}", without.import_notes());
    }
    let text = SIX_JOINT.replace("<sphere radius=\"0.05\"/>", "<mesh filename=\"a.stl\"/>");
    let arm = RobotDescription::from_urdf(&text).unwrap();
    assert!(arm.missing_shape_reasons()[0].contains("without its folder"));
}

/// Points beyond 1e6 are read where their scale makes them small, and the other way round.
#[test]
fn points_are_checked_after_scaling() {
    let folder = Folder::new("scaled");
    folder.write("ball.obj", &octahedron(5e7));
    assert_eq!(radius(&folder.with_mesh("../../ball.obj", &folder.settings())), 5e7);
    let mesh = "<mesh filename=\"../../ball.obj\" scale=\"1e6 1e6 1e6\"/>";
    let urdf = SIX_JOINT.replace("<sphere radius=\"0.05\"/>", mesh);
    for (points, words) in [
        ("v 1 0 0\nv 1e-3 inf 0", "[1000, inf, 0], as scaled"),
        ("v 1e303 0 0", "[inf, 0, 0], as scaled"),
        ("v 2 0 0", "[2000000, 0, 0], as scaled"),
    ] {
        folder.write("ball.obj", points.as_bytes());
        let arm = folder.read_with(&urdf, &folder.settings()).unwrap();
        assert!(
            arm.missing_shape_reasons()[0].contains(words),
            "{:?}",
            arm.missing_shape_reasons()
        );
    }
}
