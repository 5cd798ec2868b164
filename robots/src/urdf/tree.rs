//! Tree of links and joints, with checks that they form one.

use std::collections::HashMap;

use crate::error::DescriptionError;

/// Links and joints of a file in depth-first order, in which MuJoCo numbers bodies and joints.
pub(super) struct Tree {
    /// Indices into the file's links; the root is the first.
    pub(super) links: Vec<usize>,
    /// Indices into the file's joints; joint i carries link i + 1.
    pub(super) joints: Vec<usize>,
    /// Position in `links` of each joint's parent link.
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
        // a stack, with the children reversed so that the first one is popped first
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

    /// Rejects files with links that the root does not lead to.
    fn check_complete(&self, file: &urdf_rs::Robot) -> Result<(), DescriptionError> {
        // there is one root and one parent for every other link, so the rest hangs on a cycle
        let mut reached = vec![false; file.links.len()];
        self.links.iter().for_each(|&link| reached[link] = true);
        match reached.iter().position(|reached| !reached) {
            None => Ok(()),
            Some(link) => Err(DescriptionError::Cycle { link: file.links[link].name.clone() }),
        }
    }
}

/// Returns the indices of a joint's parent and child links.
fn ends(
    file: &urdf_rs::Robot,
    index: &HashMap<&str, usize>,
    joint: &urdf_rs::Joint,
) -> Result<[usize; 2], DescriptionError> {
    let find = |link: &String| {
        let found = index.get(&link[..]).copied();
        found.ok_or_else(|| DescriptionError::UnknownLink {
            link: link.clone(),
            requested_by: format!("the joint `{}`", joint.name),
            known: file.links.iter().map(|one| one.name.clone()).collect(),
        })
    };
    Ok([find(&joint.parent.link)?, find(&joint.child.link)?])
}

/// Returns the index of the only link without a parent.
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
