//! Tree of links and joints, with checks that they form one.

use std::collections::HashMap;

use super::Report;
use super::joints::StatedJoint;
use super::xml::Element;
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
    /// Builds the tree. `None` if links and joints form none, which is reported.
    pub(super) fn new(
        links: &[Element],
        joints: &[StatedJoint],
        report: &mut Report,
    ) -> Option<Self> {
        let index: HashMap<&str, usize> =
            links.iter().enumerate().map(|(index, link)| (link.name(), index)).collect();
        let mut children = vec![Vec::new(); links.len()];
        let mut carried_by = vec![None; links.len()];
        let before = report.errors.len();
        for (number, joint) in joints.iter().enumerate() {
            let mut find = |link: Option<&str>| {
                let link = link?;
                let found = index.get(link).copied();
                report.keep(found.ok_or_else(|| {
                    joint.element.at(DescriptionError::UnknownLink {
                        link: link.to_owned(),
                        asked: joint.element.place(),
                        known: links.iter().map(|link| link.name().to_owned()).collect(),
                    })
                }))
            };
            let [Some(parent), Some(child)] = [find(joint.parent), find(joint.child)] else {
                continue;
            };
            if let Some(first) = carried_by[child].replace(number) {
                let joints =
                    [first, number].map(|joint: usize| joints[joint].element.name().to_owned());
                let link = links[child].name().to_owned();
                report
                    .errors
                    .push(joint.element.at(DescriptionError::SeveralParents { link, joints }));
            }
            children[parent].push((number, child));
        }
        // links without their joints would only be reported as further roots
        if report.errors.len() > before || joints.iter().any(|joint| joint.child.is_none()) {
            return None;
        }
        let root = report.keep(root(links, &carried_by))?;
        let tree = Self::from_root(root, &children);
        report.keep(tree.check_complete(links))?;
        Some(tree)
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
    fn check_complete(&self, links: &[Element]) -> Result<(), DescriptionError> {
        // there is one root and one parent for every other link, so the rest hangs on a cycle
        let mut reached = vec![false; links.len()];
        self.links.iter().for_each(|&link| reached[link] = true);
        match reached.iter().position(|reached| !reached) {
            None => Ok(()),
            Some(link) => Err(cycle(links[link])),
        }
    }
}

fn cycle(link: Element) -> DescriptionError {
    link.at(DescriptionError::Cycle { link: link.name().to_owned() })
}

/// Returns the index of the only link without a parent.
fn root(links: &[Element], carried_by: &[Option<usize>]) -> Result<usize, DescriptionError> {
    let free = (0..carried_by.len()).filter(|&link| carried_by[link].is_none());
    match free.collect::<Vec<_>>()[..] {
        [root] => Ok(root),
        [] => Err(cycle(links[0])),
        ref roots => Err(DescriptionError::SeveralRoots {
            roots: roots.iter().map(|&link| links[link].name().to_owned()).collect(),
        }),
    }
}
