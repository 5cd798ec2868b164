//! The tree that the joints make of the links.

use std::collections::HashMap;

use crate::error::DescriptionError;

/// Links and joints of a file, parents before children, each link followed by all that hangs on
/// it. This is the order in which MuJoCo numbers bodies and joints.
pub(super) struct Tree {
    /// Indices of the file's links; the root is the first.
    pub(super) links: Vec<usize>,
    /// Indices of the file's joints; joint i carries link i + 1.
    pub(super) joints: Vec<usize>,
    /// Of each joint, the place of the link that carries it in `links`.
    pub(super) parents: Vec<usize>,
}

impl Tree {
    pub(super) fn new(file: &urdf_rs::Robot) -> Result<Self, DescriptionError> {
        let names = file.links.iter().enumerate();
        let index: HashMap<&str, usize> = names.map(|(i, link)| (&link.name[..], i)).collect();
        let mut children = vec![Vec::new(); file.links.len()];
        let mut carried_by = vec![None; file.links.len()];
        for (joint, stated) in file.joints.iter().enumerate() {
            let [parent, child] = ends(file, &index, stated)?;
            if let Some(first) = carried_by[child].replace(joint) {
                let joints = [first, joint].map(|joint: usize| file.joints[joint].name.clone());
                let link = file.links[child].name.clone();
                return Err(DescriptionError::SeveralParents { link, joints });
            }
            children[parent].push((joint, child));
        }
        let root = root(file, &carried_by)?;
        let tree = Self::from_root(root, &children);
        tree.check_complete(file)?;
        Ok(tree)
    }

    fn from_root(root: usize, children: &[Vec<(usize, usize)>]) -> Self {
        let mut tree = Self { links: vec![root], joints: Vec::new(), parents: Vec::new() };
        let mut open = Vec::new();
        let below = |place: usize, link: usize| {
            let children = children[link].iter().rev();
            children.map(move |&(joint, child)| (place, joint, child))
        };
        open.extend(below(0, root));
        while let Some((parent, joint, child)) = open.pop() {
            tree.parents.push(parent);
            tree.joints.push(joint);
            tree.links.push(child);
            open.extend(below(tree.joints.len(), child));
        }
        tree
    }

    /// Every link has one parent at most, so what the root does not lead to hangs on a cycle.
    fn check_complete(&self, file: &urdf_rs::Robot) -> Result<(), DescriptionError> {
        let mut reached = vec![false; file.links.len()];
        self.links.iter().for_each(|&link| reached[link] = true);
        match reached.iter().position(|reached| !reached) {
            None => Ok(()),
            Some(link) => Err(DescriptionError::Cycle { link: file.links[link].name.clone() }),
        }
    }
}

/// Indices of a joint's parent and child.
fn ends(
    file: &urdf_rs::Robot,
    index: &HashMap<&str, usize>,
    joint: &urdf_rs::Joint,
) -> Result<[usize; 2], DescriptionError> {
    let find = |link: &String| {
        let found = index.get(&link[..]).copied();
        found.ok_or_else(|| DescriptionError::UnknownLink {
            link: link.clone(),
            asked: format!("the joint `{}`", joint.name),
            known: file.links.iter().map(|link| link.name.clone()).collect(),
        })
    };
    Ok([find(&joint.parent.link)?, find(&joint.child.link)?])
}

fn root(file: &urdf_rs::Robot, carried_by: &[Option<usize>]) -> Result<usize, DescriptionError> {
    let free = (0..carried_by.len()).filter(|&link| carried_by[link].is_none());
    let name = |link: usize| file.links[link].name.clone();
    match free.collect::<Vec<_>>()[..] {
        [root] => Ok(root),
        [] => Err(DescriptionError::Cycle { link: name(0) }),
        ref roots => Err(DescriptionError::SeveralRoots {
            roots: roots.iter().map(|&link| name(link)).collect(),
        }),
    }
}
