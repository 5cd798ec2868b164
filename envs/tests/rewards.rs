//! Rewards and successes against a run of Meta-World itself.
//!
//! The rows are five steps each of a scripted expert's episode, recorded in Meta-World 3.1.1 on
//! MuJoCo 2.2.2 (weld torquescale 1): an early one, one halfway to success, the last before it, the
//! first with it, and step 200. In Python a row is
//!
//! ```python
//! observation, reward, _, _, info = env.step(action)      # step k, action[3] clipped to [-1, 1]
//! row(goal=env._target_pos, start_tcp=env.init_tcp, start_object=observation_at_reset[4:7],
//! tcp=env.tcp_center,
//!     object=observation[4:7], aperture=observation[3], finger=action[3], reward=reward,
//! success=info["success"])
//! ```
//!
//! with the table's centre (0, 0.6) moved to the origin; Goal Reach is raised by 0.02 m, since our
//! hand starts that much higher and the reward's margin is counted from there.

use envs::{EpisodeStart, Measurement, Placement, TaskGroup};
use glam::DVec3;

struct Row {
    group: TaskGroup,
    goal: [f64; 3],
    start_tcp: [f64; 3],
    start_object: [f64; 3],
    tcp: [f64; 3],
    object: [f64; 3],
    aperture: f64,
    finger: f64,
    reward: f64,
    success: bool,
}

fn measurement(tcp: [f64; 3], object: [f64; 3], aperture: f64) -> Measurement {
    Measurement {
        hand: DVec3::from_array(tcp),
        tcp: DVec3::from_array(tcp),
        aperture,
        object: DVec3::from_array(object),
        // read by tasks with loose objects only
        tip: DVec3::ZERO,
        pads: [0.0; 2],
    }
}

#[test]
fn rewards_and_successes_are_meta_worlds() {
    let (mut successes, mut failures) = (0, 0);
    for (index, row) in ROWS.iter().enumerate() {
        let goal = DVec3::from_array(row.goal);
        let start = EpisodeStart {
            placement: Placement { object: goal, goal },
            hand_target: envs::HAND_TARGET_START,
            measurement: measurement(row.start_tcp, row.start_object, 1.0),
        };
        let now = measurement(row.tcp, row.object, row.aperture);
        let got = row.group.task().reward(&start, &now, row.finger);
        let difference = (got.reward - row.reward).abs();
        assert!(
            difference < 1e-9,
            "{} row {index}: {} is not {}",
            row.group,
            got.reward,
            row.reward
        );
        assert_eq!(got.success, row.success, "{} row {index}", row.group);
        successes += usize::from(got.success);
        failures += usize::from(!got.success);
    }
    assert_eq!((successes, failures), (8, 12));
}

#[rustfmt::skip]
const ROWS: [Row; 20] = [
    Row { group: TaskGroup::GOAL_REACH, goal: [0.08972988942744878, 0.23118314520104866, 0.1758316122431439], start_tcp: [0.006003638241045807, 0.0004761759632928575, 0.16935032274391257], start_object: [0.08972988942744878, 0.23118314520104866, 0.1758316122431439], tcp: [0.009135699334206961, 0.011758444118612266, 0.16669511715359925], object: [0.08972988942744878, 0.23118314520104866, 0.1758316122431439], aperture: 1.0, finger: 0.0, reward: 1.7244085173311778, success: false },
    Row { group: TaskGroup::GOAL_REACH, goal: [0.08972988942744878, 0.23118314520104866, 0.1758316122431439], start_tcp: [0.006003638241045807, 0.0004761759632928575, 0.16935032274391257], start_object: [0.08972988942744878, 0.23118314520104866, 0.1758316122431439], tcp: [0.05952602679030014, 0.13792986035242394, 0.1484699641100703], object: [0.08972988942744878, 0.23118314520104866, 0.1758316122431439], aperture: 0.9969118991625573, finger: 0.0, reward: 7.245477838145064, success: false },
    Row { group: TaskGroup::GOAL_REACH, goal: [0.08972988942744878, 0.23118314520104866, 0.1758316122431439], start_tcp: [0.006003638241045807, 0.0004761759632928575, 0.16935032274391257], start_object: [0.08972988942744878, 0.23118314520104866, 0.1758316122431439], tcp: [0.08013314043916331, 0.19958496800137226, 0.13730755806855405], object: [0.08972988942744878, 0.23118314520104866, 0.1758316122431439], aperture: 0.9966791446618043, finger: 0.0, reward: 9.99922127869853, success: false },
    Row { group: TaskGroup::GOAL_REACH, goal: [0.08972988942744878, 0.23118314520104866, 0.1758316122431439], start_tcp: [0.006003638241045807, 0.0004761759632928575, 0.16935032274391257], start_object: [0.08972988942744878, 0.23118314520104866, 0.1758316122431439], tcp: [0.08054341928778805, 0.20144222391548838, 0.13695358408367417], object: [0.08972988942744878, 0.23118314520104866, 0.1758316122431439], aperture: 0.9966897916617121, finger: 0.0, reward: 10.0, success: true },
    Row { group: TaskGroup::GOAL_REACH, goal: [0.08972988942744878, 0.23118314520104866, 0.1758316122431439], start_tcp: [0.006003638241045807, 0.0004761759632928575, 0.16935032274391257], start_object: [0.08972988942744878, 0.23118314520104866, 0.1758316122431439], tcp: [0.08961555455617021, 0.23040521708139083, 0.13072156408650618], object: [0.08972988942744878, 0.23118314520104866, 0.1758316122431439], aperture: 0.9985249140428206, finger: 0.0, reward: 10.0, success: true },
    Row { group: TaskGroup::BUTTON_PRESS, goal: [0.0023643249400513433, 0.19752318481629683, 0.115], start_tcp: [0.005880278004062014, -0.20023987776217922, 0.1499848193515822], start_object: [0.0023643249400513433, 0.10452318481629674, 0.115], tcp: [0.00016951441213863762, -0.2028042075030072, 0.13636586136166431], object: [0.0023643249400513433, 0.10384517977894425, 0.115], aperture: 1.0, finger: 0.0, reward: 0.2716058971268971, success: false },
    Row { group: TaskGroup::BUTTON_PRESS, goal: [0.0023643249400513433, 0.19752318481629683, 0.115], start_tcp: [0.005880278004062014, -0.20023987776217922, 0.1499848193515822], start_object: [0.0023643249400513433, 0.10452318481629674, 0.115], tcp: [0.0073318298315207375, -0.07851411273284525, 0.0030691480256445046], object: [0.0023643249400513433, 0.10391235607610161, 0.115], aperture: 0.9992875561098475, finger: 0.0, reward: 0.5577923755129571, success: false },
    Row { group: TaskGroup::BUTTON_PRESS, goal: [0.0023643249400513433, 0.19752318481629683, 0.115], start_tcp: [0.005880278004062014, -0.20023987776217922, 0.1499848193515822], start_object: [0.0023643249400513433, 0.10452318481629674, 0.115], tcp: [0.003868542523375397, 0.1480531207888024, -0.00013695102961971267], object: [0.0023643249400513433, 0.1767358029809668, 0.115], aperture: 0.8702322386300121, finger: 0.0, reward: 1.383944595667578, success: false },
    Row { group: TaskGroup::BUTTON_PRESS, goal: [0.0023643249400513433, 0.19752318481629683, 0.115], start_tcp: [0.005880278004062014, -0.20023987776217922, 0.1499848193515822], start_object: [0.0023643249400513433, 0.10452318481629674, 0.115], tcp: [0.003475895806330214, 0.15045139263785423, 0.0004336476851113623], object: [0.0023643249400513433, 0.1787987071408611, 0.115], aperture: 0.8536640165837779, finger: 0.0, reward: 1.3709551451010222, success: true },
    Row { group: TaskGroup::BUTTON_PRESS, goal: [0.0023643249400513433, 0.19752318481629683, 0.115], start_tcp: [0.005880278004062014, -0.20023987776217922, 0.1499848193515822], start_object: [0.0023643249400513433, 0.10452318481629674, 0.115], tcp: [0.0033090410486106983, 0.17466546500827473, 0.0020885541187677], object: [0.0023643249400513433, 0.18943011247400132, 0.115], aperture: 0.6964481746781451, finger: 0.0, reward: 1.1934981857849314, success: true },
    Row { group: TaskGroup::DRAWER_CLOSE, goal: [0.0023643249400513433, 0.14, 0.09], start_tcp: [0.006003638145006345, 0.00047619994563163903, 0.1493503258076347], start_object: [0.0023643249400513433, -0.020000000000000018, 0.14], tcp: [0.006241386383155968, 0.00239037686086907, 0.1637052251732173], object: [0.0023643249400513433, -0.02149732510102198, 0.14], aperture: 0.9153900645918842, finger: 1.0, reward: 0.0228942398691456, success: false },
    Row { group: TaskGroup::DRAWER_CLOSE, goal: [0.0023643249400513433, 0.14, 0.09], start_tcp: [0.006003638145006345, 0.00047619994563163903, 0.1493503258076347], start_object: [0.0023643249400513433, -0.020000000000000018, 0.14], tcp: [0.0012220352588809876, -0.10684845669381166, 0.20669481025302566], object: [0.0023643249400513433, -0.02653544084702064, 0.14], aperture: 0.29667565992641337, finger: 1.0, reward: 6.656638884444707e-31, success: false },
    Row { group: TaskGroup::DRAWER_CLOSE, goal: [0.0023643249400513433, 0.14, 0.09], start_tcp: [0.006003638145006345, 0.00047619994563163903, 0.1493503258076347], start_object: [0.0023643249400513433, -0.020000000000000018, 0.14], tcp: [0.0021542394200830695, 0.0764990020473243, 0.07751692548159111], object: [0.0023643249400513433, 0.09417442586962876, 0.14], aperture: 0.2966718423006378, finger: 1.0, reward: 4.6268644774155826e-11, success: false },
    Row { group: TaskGroup::DRAWER_CLOSE, goal: [0.0023643249400513433, 0.14, 0.09], start_tcp: [0.006003638145006345, 0.00047619994563163903, 0.1493503258076347], start_object: [0.0023643249400513433, -0.020000000000000018, 0.14], tcp: [0.0026868226327121767, 0.08232005536189835, 0.07697141803783956], object: [0.0023643249400513433, 0.09966418677374556, 0.14], aperture: 0.296672620630569, finger: 1.0, reward: 10.0, success: true },
    Row { group: TaskGroup::DRAWER_CLOSE, goal: [0.0023643249400513433, 0.14, 0.09], start_tcp: [0.006003638145006345, 0.00047619994563163903, 0.1493503258076347], start_object: [0.0023643249400513433, -0.020000000000000018, 0.14], tcp: [0.003978335901504815, 0.12484953301653678, 0.07394274338588629], object: [0.0023643249400513433, 0.13410484108898646, 0.14], aperture: 0.2916579098386539, finger: 1.0, reward: 10.0, success: true },
    Row { group: TaskGroup::PLATE_SLIDE, goal: [0.08972988942744878, 0.26559157260052424, 0.0], start_tcp: [0.006003638145006345, 0.00047619994563163903, 0.1493503258076347], start_object: [0.0, 0.0, 0.015], tcp: [0.0030419984742676162, -0.00939871519173019, 0.14166429736247035], object: [0.0, 0.0, 0.015], aperture: 1.0, finger: -1.0, reward: 0.8431250720573361, success: false },
    Row { group: TaskGroup::PLATE_SLIDE, goal: [0.08972988942744878, 0.26559157260052424, 0.0], start_tcp: [0.006003638145006345, 0.00047619994563163903, 0.1493503258076347], start_object: [0.0, 0.0, 0.015], tcp: [0.014917155007934214, -0.03507962372551732, 0.028730029686583357], object: [0.01403451760254543, 0.010786831120638718, 0.015], aperture: 1.0, finger: -1.0, reward: 1.2589499571672889, success: false },
    Row { group: TaskGroup::PLATE_SLIDE, goal: [0.08972988942744878, 0.26559157260052424, 0.0], start_tcp: [0.006003638145006345, 0.00047619994563163903, 0.1493503258076347], start_object: [0.0, 0.0, 0.015], tcp: [0.08828873459030213, 0.15213095040381197, 0.026566761880090044], object: [0.10095072501071674, 0.1926620233623343, 0.015], aperture: 1.0, finger: -1.0, reward: 7.453759304215723, success: false },
    Row { group: TaskGroup::PLATE_SLIDE, goal: [0.08972988942744878, 0.26559157260052424, 0.0], start_tcp: [0.006003638145006345, 0.00047619994563163903, 0.1493503258076347], start_object: [0.0, 0.0, 0.015], tcp: [0.08818893390388152, 0.15820210235892218, 0.026323003052080372], object: [0.10113358869739446, 0.19875758233934004, 0.015], aperture: 1.0, finger: -1.0, reward: 7.6681597604200915, success: true },
    Row { group: TaskGroup::PLATE_SLIDE, goal: [0.08972988942744878, 0.26559157260052424, 0.0], start_tcp: [0.006003638145006345, 0.00047619994563163903, 0.1493503258076347], start_object: [0.0, 0.0, 0.015], tcp: [0.09497884492973765, 0.23439565414550223, 0.03782349897449038], object: [0.09694308810679148, 0.2592237163288281, 0.015], aperture: 1.0, finger: -1.0, reward: 10.0, success: true },
];
