//! Tree of links and joints, with checks that they form one.

use std::collections::HashMap;

use super::Report;
use super::names;
use super::xml::Cleaned;
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
    /// Builds the tree of a file's links and joints. Fails with all errors of `report` if links and
    /// joints form none, or have invalid names.
    pub(super) fn new(
        file: &urdf_rs::Robot,
        cleaned: &Cleaned,
        report: &mut Report,
    ) -> Result<Self, DescriptionError> {
        let mut sound = names::check(file, cleaned, report);
        let names = file.links.iter().enumerate();
        let index: HashMap<&str, usize> = names.map(|(i, link)| (&link.name[..], i)).collect();
        let mut children = vec![Vec::new(); file.links.len()];
        let mut carried_by = vec![None; file.links.len()];
        for (number, joint) in file.joints.iter().enumerate() {
            let line = cleaned.joint_lines[number];
            let [parent, child] = [&joint.parent.link, &joint.child.link].map(|end| {
                let found = index.get(&end[..]).copied();
                // a link without a name was reported already
                if found.is_none() && !end.is_empty() {
                    let link = end.clone();
                    let requested_by = format!("the joint `{}`", joint.name);
                    let known = file.links.iter().map(|known| known.name.clone()).collect();
                    report
                        .reject(line, DescriptionError::UnknownLink { link, requested_by, known });
                }
                found
            });
            let (Some(parent), Some(child)) = (parent, child) else {
                sound = false;
                continue;
            };
            if let Some(first) = carried_by[child].replace(number) {
                let joints =
                    [first, number].map(|carrier: usize| file.joints[carrier].name.clone());
                let link = file.links[child].name.clone();
                report.reject(line, DescriptionError::SeveralParents { link, joints });
                sound = false;
            }
            children[parent].push((number, child));
        }
        // links without their joints would only be reported as further roots
        if !sound {
            report.check()?;
        }
        let name = |link: usize| file.links[link].name.clone();
        let free = (0..file.links.len()).filter(|&link| carried_by[link].is_none());
        let free: Vec<usize> = free.collect();
        if free.len() > 1 {
            let roots = free.iter().copied().map(name).collect();
            report.reject(0, DescriptionError::SeveralRoots { roots });
            report.check()?;
        }
        let tree = Self::from_root(free.first().copied(), &children);
        // every link but the root has one parent, so those that the root does not lead to are on a
        // cycle, or hang on one
        if let Some(link) = (0..file.links.len()).find(|link| !tree.links.contains(link)) {
            report.reject(cleaned.link_lines[link], DescriptionError::Cycle { link: name(link) });
            report.check()?;
        }
        Ok(tree)
    }

    fn from_root(root: Option<usize>, children: &[Vec<(usize, usize)>]) -> Self {
        let links = root.into_iter().collect();
        let mut tree = Self { links, joints: Vec::new(), parents: Vec::new() };
        // a stack, with the children reversed so that the first one is popped first
        let mut open = Vec::new();
        let below = |place: usize, link: usize| {
            let children = children[link].iter().rev();
            children.map(move |&(joint, child)| (place, joint, child))
        };
        open.extend(root.into_iter().flat_map(|root| below(0, root)));
        while let Some((parent, joint, child)) = open.pop() {
            tree.parents.push(parent);
            tree.joints.push(joint);
            tree.links.push(child);
            open.extend(below(tree.joints.len(), child));
        }
        tree
    }
}
