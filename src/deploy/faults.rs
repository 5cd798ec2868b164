//! What is wrong with a rig and its camera, as amounts that a sweep goes through.

use std::str::FromStr;

use crate::error::CoversError;

use super::settings::SightSettings;
use super::simulated::SimulationSettings;

/// Something that is wrong, or is chosen, more or less.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// How far the camera is from where its calibration has it (mm).
    PositionError,
    /// How far it is turned from how its calibration has it (degrees).
    AngleError,
    /// Age of a picture when it comes (ms).
    PictureLatency,
    /// From a command to its effect (ms).
    CommandLatency,
    /// How far the exposure wanders (%).
    ExposureDrift,
    /// How far the gains of red and blue wander (%).
    BalanceDrift,
    /// How much thicker than the arm the mask is (mm).
    MaskGrowth,
}

impl Fault {
    /// All, in the order of the page.
    pub const ALL: [Self; 7] = [
        Self::PositionError,
        Self::AngleError,
        Self::PictureLatency,
        Self::CommandLatency,
        Self::ExposureDrift,
        Self::BalanceDrift,
        Self::MaskGrowth,
    ];

    /// Its name in commands and files.
    pub fn name(self) -> &'static str {
        match self {
            Self::PositionError => "position-error",
            Self::AngleError => "angle-error",
            Self::PictureLatency => "picture-latency",
            Self::CommandLatency => "command-latency",
            Self::ExposureDrift => "exposure-drift",
            Self::BalanceDrift => "balance-drift",
            Self::MaskGrowth => "mask-growth",
        }
    }

    /// Its name and unit under an axis.
    pub fn axis(self) -> &'static str {
        match self {
            Self::PositionError => "error of the camera's position (mm)",
            Self::AngleError => "error of the camera's angle (degrees)",
            Self::PictureLatency => "age of pictures (ms)",
            Self::CommandLatency => "age of commands (ms)",
            Self::ExposureDrift => "drift of the exposure (%)",
            Self::BalanceDrift => "drift of the white balance (%)",
            Self::MaskGrowth => "growth of the mask (mm)",
        }
    }

    /// Sets this much of it, in its unit. Amounts out of range are refused where settings are used.
    pub fn set(self, amount: f64, rig: &mut SimulationSettings, sight: &mut SightSettings) {
        let camera = &mut rig.imperfections;
        match self {
            Self::PositionError => camera.position_error = amount / 1e3,
            Self::AngleError => camera.angle_error = amount.to_radians(),
            Self::PictureLatency => camera.latency = amount / 1e3,
            Self::CommandLatency => rig.command_latency = amount / 1e3,
            Self::ExposureDrift => camera.exposure_drift = amount / 1e2,
            Self::BalanceDrift => camera.balance_drift = amount / 1e2,
            Self::MaskGrowth => sight.growth = amount / 1e3,
        }
    }
}

/// A fault with the amounts of it that are tried, as `angle-error=0,0.5,1` says.
#[derive(Clone, Debug, PartialEq)]
pub struct FaultSweep {
    /// What is wrong.
    pub fault: Fault,
    /// Rising amounts, in its unit; at least one.
    pub amounts: Vec<f64>,
}

impl FromStr for FaultSweep {
    type Err = CoversError;

    fn from_str(text: &str) -> Result<Self, CoversError> {
        let refused = |expected| CoversError::Setting {
            name: "sweep",
            value: text.to_owned(),
            expected,
        };
        let (name, amounts) = text.split_once('=').ok_or_else(|| refused(FORM))?;
        let fault = Fault::ALL.into_iter().find(|fault| fault.name() == name);
        let fault = fault.ok_or_else(|| refused(NAMES))?;
        let amounts: Result<Vec<f64>, _> = amounts.split(',').map(str::parse).collect();
        let amounts = amounts.map_err(|_| refused(FORM))?;
        let from_zero = amounts
            .iter()
            .all(|amount| *amount >= 0.0 && amount.is_finite());
        let rising = amounts.windows(2).all(|pair| pair[0] < pair[1]);
        match from_zero && rising {
            true => Ok(Self { fault, amounts }),
            false => Err(refused("rising amounts, none below 0")),
        }
    }
}

const FORM: &str = "a fault and amounts of it, as `position-error=0,5,10`";
const NAMES: &str = "position-error (mm), angle-error (degrees), picture-latency (ms), \
                     command-latency (ms), exposure-drift (%), balance-drift (%) or \
                     mask-growth (mm)";

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sweep_is_read_as_it_is_written() {
        for fault in Fault::ALL {
            assert!(NAMES.contains(fault.name()), "{}", fault.name());
            let sweep: FaultSweep = format!("{}=0,2.5,30", fault.name()).parse().unwrap();
            let amounts = vec![0.0, 2.5, 30.0];
            assert_eq!(sweep, FaultSweep { fault, amounts });
        }
    }

    #[test]
    fn what_is_no_sweep_is_refused_with_what_was_expected() {
        for (text, says) in [
            ("position-error", FORM),
            ("position-error=", FORM),
            ("position-error=5mm", FORM),
            ("position=5", NAMES),
            ("angle-error=1,1", "rising"),
            ("angle-error=-1", "rising"),
            ("angle-error=inf", "rising"),
            ("angle-error=NaN", "rising"),
        ] {
            let message = text.parse::<FaultSweep>().unwrap_err().to_string();
            assert!(
                message.contains(says) && message.contains(text),
                "{message}"
            );
        }
    }

    /// Each changes one figure, and the figures of the page are the nominal ones.
    #[test]
    fn amounts_are_in_the_units_that_axes_name() {
        let nominal = (SimulationSettings::NOMINAL, SightSettings::default());
        let amounts = [5.0, 0.5, 60.0, 25.0, 10.0, 3.0, 20.0];
        for (fault, amount) in Fault::ALL.into_iter().zip(amounts) {
            let (mut rig, mut sight) = nominal;
            fault.set(0.0, &mut rig, &mut sight);
            assert_ne!((rig, sight), nominal, "{}", fault.name());
            fault.set(amount, &mut rig, &mut sight);
            assert_eq!((rig, sight), nominal, "{}", fault.name());
        }
    }
}
