//! Faults of a simulated rig and its camera, with amounts for sweeps.

use std::str::FromStr;

use crate::DeployError;
use experiments::RunError;

use super::settings::RigAndVisionSettings;

/// Fault of a simulated rig, or setting of the perception, whose amount can be varied.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SimulatedFault {
    /// Distance of the camera from its calibrated position (mm).
    PositionError,
    /// Angle between the camera and its calibrated orientation (degrees).
    AngleError,
    /// Age of a picture on arrival (ms), rounded up to control steps of 12.5 ms.
    PictureLatency,
    /// Delay from a command to its effect (ms, a multiple of the control step of 12.5 ms).
    CommandLatency,
    /// Standard deviation of the drift of the camera's exposure (%).
    ExposureDrift,
    /// Standard deviation of the drift of the camera's gains of red and blue (%).
    WhiteBalanceDrift,
    /// Margin of the mask around the arm in the camera's picture (mm).
    MaskMargin,
}

impl SimulatedFault {
    /// All faults whose amount can be varied.
    pub const ALL: [Self; 7] = [
        Self::PositionError,
        Self::AngleError,
        Self::PictureLatency,
        Self::CommandLatency,
        Self::ExposureDrift,
        Self::WhiteBalanceDrift,
        Self::MaskMargin,
    ];

    /// Returns the fault's name in commands and files.
    pub fn name(self) -> &'static str {
        match self {
            Self::PositionError => "position-error",
            Self::AngleError => "angle-error",
            Self::PictureLatency => "picture-latency",
            Self::CommandLatency => "command-latency",
            Self::ExposureDrift => "exposure-drift",
            Self::WhiteBalanceDrift => "balance-drift",
            Self::MaskMargin => "mask-growth",
        }
    }

    /// Returns the fault's label for the axis of a figure: name and unit.
    pub fn axis_label(self) -> &'static str {
        match self {
            Self::PositionError => "error of the camera's position (mm)",
            Self::AngleError => "error of the camera's angle (degrees)",
            Self::PictureLatency => "age of pictures (ms)",
            Self::CommandLatency => "age of commands (ms)",
            Self::ExposureDrift => "drift of the exposure (%)",
            Self::WhiteBalanceDrift => "drift of the white balance (%)",
            Self::MaskMargin => "growth of the mask (mm)",
        }
    }

    /// Returns `settings` with this amount of the fault, in its unit.
    ///
    /// # Errors
    /// An amount out of range.
    pub fn set_amount(
        self,
        amount: f64,
        mut settings: RigAndVisionSettings,
    ) -> Result<RigAndVisionSettings, DeployError> {
        let RigAndVisionSettings { simulation, vision } = &mut settings;
        let camera = &mut simulation.camera_imperfections;
        match self {
            Self::PositionError => camera.position_error = amount / 1e3,
            Self::AngleError => camera.angle_error = amount.to_radians(),
            Self::PictureLatency => camera.latency = amount / 1e3,
            Self::CommandLatency => simulation.command_latency_s = amount / 1e3,
            Self::ExposureDrift => camera.exposure_drift_sd = amount / 1e2,
            Self::WhiteBalanceDrift => camera.white_balance_drift_sd = amount / 1e2,
            Self::MaskMargin => vision.mask_margin_m = amount / 1e3,
        }
        camera.check()?;
        let in_range = match self {
            // below the age of 500 ms at which the arm is stopped
            Self::PictureLatency => amount <= 400.0,
            // the simulation delays commands by whole control steps
            Self::CommandLatency => amount <= 1000.0 && amount % 12.5 == 0.0,
            Self::MaskMargin => amount <= 1000.0,
            _ => true,
        };
        if in_range {
            return Ok(settings);
        }
        Err(RunError::invalid(
            self.name(),
            amount,
            "a picture-latency of at most 400 ms, a command-latency of whole control \
                       steps of 12.5 ms up to 1000 ms, a mask-growth of at most 1000 mm",
        )
        .into())
    }
}

/// Fault with the amounts to try, parsed from text such as `angle-error=0,0.5,1`.
#[derive(Clone, Debug, PartialEq)]
pub struct FaultSweep {
    /// Fault whose amount is varied.
    pub fault: SimulatedFault,
    /// Rising amounts in the fault's unit; the last one is above 0.
    pub amounts: Vec<f64>,
}

impl FromStr for FaultSweep {
    type Err = DeployError;

    fn from_str(text: &str) -> Result<Self, DeployError> {
        let refused = |expected| RunError::invalid("sweep", text, expected);
        let (fault, amounts) = named(text)?;
        let amounts: Result<Vec<f64>, _> = amounts.split(',').map(str::parse).collect();
        let amounts = amounts.map_err(|_| refused(FORM))?;
        let from_zero = amounts.iter().all(|amount| *amount >= 0.0 && amount.is_finite());
        let rising = amounts.windows(2).all(|pair| pair[0] < pair[1]);
        // a sweep of 0 alone would show no fault
        if from_zero && rising && amounts.last() > Some(&0.0) {
            return Ok(Self { fault, amounts });
        }
        Err(refused("rising amounts, none below 0 and one above").into())
    }
}

/// Fault with one amount, parsed from text such as `angle-error=3`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FaultAmount {
    /// Fault whose amount is set.
    pub fault: SimulatedFault,
    /// Amount of the fault in its unit; 0 or more.
    pub amount: f64,
}

impl FromStr for FaultAmount {
    type Err = DeployError;

    fn from_str(text: &str) -> Result<Self, DeployError> {
        let (fault, amount) = named(text)?;
        let in_range = |parsed: &f64| *parsed >= 0.0 && parsed.is_finite();
        let amount = amount.parse().ok().filter(in_range).ok_or_else(|| {
            RunError::invalid(
                "fault",
                text,
                "a fault and an amount of it, 0 or more, as `position-error=5`",
            )
        })?;
        Ok(Self { fault, amount })
    }
}

fn named(text: &str) -> Result<(SimulatedFault, &str), DeployError> {
    let refused = |expected| RunError::invalid("fault", text, expected);
    let (name, amounts) = text.split_once('=').ok_or_else(|| refused(FORM))?;
    let fault = SimulatedFault::ALL.into_iter().find(|fault| fault.name() == name);
    Ok((fault.ok_or_else(|| refused(NAMES))?, amounts))
}

/// Expected form of a fault with amounts, for error messages.
const FORM: &str = "a fault and amounts of it, as `position-error=0,5,10`";
/// Names and units of all faults, for error messages.
const NAMES: &str = "position-error (mm), angle-error (degrees), picture-latency (ms), \
                     command-latency (ms), exposure-drift (%), balance-drift (%) or \
                     mask-growth (mm)";

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sweep_is_read_as_it_is_written() {
        for fault in SimulatedFault::ALL {
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
            ("angle-error=0", "rising"),
        ] {
            let message = text.parse::<FaultSweep>().unwrap_err().to_string();
            assert!(message.contains(says) && message.contains(text), "{message}");
        }
    }

    #[test]
    fn one_amount_is_read_or_refused() {
        for fault in SimulatedFault::ALL {
            let one: FaultAmount = format!("{}=0", fault.name()).parse().unwrap();
            assert_eq!(one, FaultAmount { fault, amount: 0.0 });
        }
        for (text, says) in [
            ("angle-error", FORM),
            ("angle=3", NAMES),
            ("angle-error=1,2", "an amount of it"),
            ("angle-error=-1", "an amount of it"),
            ("angle-error=NaN", "an amount of it"),
        ] {
            let message = text.parse::<FaultAmount>().unwrap_err().to_string();
            assert!(message.contains(says), "{message}");
        }
    }

    /// Checks that each fault changes one setting, and that the nominal amounts are those of
    /// docs/deployment.md.
    #[test]
    fn amounts_are_in_the_units_that_axes_name() {
        let nominal = RigAndVisionSettings::NOMINAL_FAULTS;
        let amounts = [5.0, 0.5, 60.0, 25.0, 10.0, 3.0, 20.0];
        for (fault, amount) in SimulatedFault::ALL.into_iter().zip(amounts) {
            let none = fault.set_amount(0.0, nominal).unwrap();
            assert_ne!(none, nominal, "{}", fault.name());
            assert_eq!(fault.set_amount(amount, none).unwrap(), nominal, "{}", fault.name());
        }
    }

    #[test]
    fn amounts_out_of_range_are_refused() {
        let nominal = RigAndVisionSettings::NOMINAL_FAULTS;
        for (fault, amount, says) in [
            (SimulatedFault::PositionError, 101.0, "`position_error` is 0.101"),
            (SimulatedFault::AngleError, 12.0, "`angle_error`"),
            (SimulatedFault::PictureLatency, 450.0, "450"),
            (SimulatedFault::CommandLatency, 20.0, "12.5"),
            (SimulatedFault::ExposureDrift, 101.0, "`exposure_drift_sd`"),
            (SimulatedFault::MaskMargin, 1001.0, "mask-growth"),
        ] {
            let message = fault.set_amount(amount, nominal).unwrap_err().to_string();
            assert!(message.contains(says), "{message}");
        }
    }
}
