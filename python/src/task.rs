//! Parser of the task names of the Python package, such as `goal-reach` and `button-press-flip-x`.

use envs::{Layout, TaskGroup, TaskRegistry};
use pyo3::PyResult;
use symmetry::D2;

use crate::{error, value_error};

/// Returns the names of all task groups, then those of their variants.
pub fn task_names() -> Vec<String> {
    let groups = TaskGroup::ALL.map(|group| group.name().to_owned());
    let variants = TaskGroup::ALL.map(|group| D2::ALL.map(|element| name(group, element)));
    [&groups[..], variants.as_flattened()].concat()
}

/// Returns the names of the sets of task groups, each with the names of its groups.
pub fn task_sets() -> Vec<(&'static str, Vec<&'static str>)> {
    let names = |groups: &[TaskGroup]| groups.iter().map(|group| group.name()).collect();
    TaskGroup::TASK_SETS.map(|(set, groups)| (set, names(groups))).to_vec()
}

/// Returns the only group that the task names `tasks` belong to, and the elements of D2 to draw its
/// variants from; an error if they belong to several groups. A group's name stands for all elements
/// of the layout.
pub fn parse_group_and_variants(
    tasks: &[String],
    layout: Layout,
) -> PyResult<(TaskGroup, Vec<D2>)> {
    let mut found: Option<(TaskGroup, Vec<D2>)> = None;
    for task in tasks {
        let (group, elements) = find(task, layout)?;
        match &mut found {
            None => found = Some((group, elements)),
            Some((first, all)) if *first == group => all.extend(elements),
            Some((first, _)) => return Err(value_error(mixed(*first, group))),
        }
    }
    found.ok_or_else(|| value_error("no task is named: name at least one"))
}

fn mixed(first: TaskGroup, second: TaskGroup) -> String {
    format!(
        "the tasks are variants of {first} and of {second}: the environments of one vector are \
         variants of one group, so make a vector for each group, or switch with `set_task`"
    )
}

fn find(task: &str, layout: Layout) -> PyResult<(TaskGroup, Vec<D2>)> {
    for group in TaskGroup::ALL {
        let element = D2::ALL.into_iter().find(|&g| name(group, g) == task);
        if let Some(element) = element {
            return Ok((group, vec![element]));
        }
    }
    let group = TaskRegistry::with_all().find(task).map_err(error)?;
    Ok((group, layout.group_elements().to_vec()))
}

fn name(group: TaskGroup, element: D2) -> String {
    format!("{group}-{element}").replace(' ', "-")
}
