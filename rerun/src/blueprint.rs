//! Layout of a recording in the viewer: a tab for the stream, and one for each group.

use envs::TaskGroup;
use re_sdk::blueprint::{
    Blueprint, ContainerLike, Horizontal, Spatial2DView, Spatial3DView, StateTimelineView, Tabs,
    TimePanel, TimeSeriesView, Vertical,
};
use re_sdk_types::blueprint::components::PlayState;

use covers::RunData;

use crate::episode::{VIEWS, place};
use crate::recording::{DECISION, ROLLOUTS};

/// Returns the viewer's layout: a tab for the stream if the run's tables hold rollouts, and one for
/// each group, whose four variants stand side by side. Episodes play in real time.
pub(crate) fn of(run: &RunData, groups: &[TaskGroup]) -> Blueprint {
    let has_stream = !run.rollouts.is_empty();
    let stream = has_stream.then(stream);
    let groups = groups.iter().map(|&group| of_group(group));
    let decision = run.experiment.envs.control.decision_seconds();
    let time = TimePanel::new().with_fps(decision.recip());
    // the stream's rollouts are for stepping through, and episodes for watching
    let time = if has_stream {
        time.with_timeline(ROLLOUTS).with_play_state(PlayState::Paused)
    } else {
        time.with_timeline(DECISION)
    };
    Blueprint::new(Tabs::new(stream.into_iter().chain(groups))).with_time_panel(time)
}

fn stream() -> ContainerLike {
    let series = |name: &str, contents: &[&str]| {
        let view = TimeSeriesView::new(name).with_origin("stream");
        view.with_contents(contents.iter().copied()).into()
    };
    let lanes = StateTimelineView::new("group and policy").with_origin("stream");
    let lanes = lanes.with_contents(["/stream/group", "/stream/policy"]);
    Vertical::new([
        lanes.into(),
        series("success", &["/stream/success", "/stream/evaluation/**"]),
        series("reward", &["/stream/reward"]),
        series("W1 and thresholds", &["/stream/distance/**", "/stream/threshold/**"]),
    ])
    .with_name("stream")
    .with_row_shares([1.0, 2.0, 2.0, 2.0])
    .into()
}

fn of_group(group: TaskGroup) -> ContainerLike {
    let variants = group.variants();
    let names = variants.map(|variant| (place(variant), variant.element.to_string()));
    let row = |view: &dyn Fn(&str, &str) -> ContainerLike| {
        let views = names.iter().map(|(place, name)| view(place, name));
        Horizontal::new(views).into()
    };
    let tables = row(&|place, name| {
        let view = Spatial3DView::new(name).with_origin(format!("{place}/table"));
        view.with_contents(["$origin/**"]).into()
    });
    let pictures = VIEWS.map(|(_, path)| {
        row(&|place, name| {
            let kind = path.rsplit('/').next().unwrap_or(path);
            let view = Spatial2DView::new(format!("{name}: {kind}"));
            view.with_origin(format!("{place}/{path}")).into()
        })
    });
    let rewards = row(&|place, name| {
        let view = TimeSeriesView::new(format!("{name}: reward"));
        view.with_origin(format!("{place}/reward")).into()
    });
    let rows = std::iter::once(tables).chain(pictures).chain([rewards]);
    Vertical::new(rows)
        .with_name(group.to_string())
        .with_row_shares([3.0, 2.0, 2.0, 2.0, 1.0])
        .into()
}
