//! Report of a check as one HTML page, with pictures of the model.

use std::error::Error;
use std::f64::consts::FRAC_PI_2;
use std::fmt::Write;
use std::sync::Arc;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use glam::DVec3;
use mujoco::{Data, FreeCamera, Model, RenderOptions, Renderer};
use robots::xml_escaped;

use crate::check::ModelSymmetryReport;
use crate::compare::MirrorDifference;
use crate::error::ModelSymmetryError;
use crate::mirror::MirrorPlane;

/// Width and height of the pictures (pixels).
const SIZE: [usize; 2] = [480, 480];

type PictureError = Box<dyn Error + Send + Sync>;

const STYLE: &str = "\
:root { color-scheme: light dark; font: 16px/1.5 system-ui, sans-serif }
body { max-width: 64rem; margin: 2rem auto; padding: 0 1rem }
img { width: 100%; height: auto }
.pictures { display: grid; grid-template-columns: repeat(auto-fit, minmax(16rem, 1fr)); gap: 1rem }
figure { margin: 0 }
.wide { overflow-x: auto }
table { border-collapse: collapse; width: 100% }
th, td { text-align: left; vertical-align: top; padding: .3rem .6rem; border-bottom: 1px solid #8888 }
.number { text-align: right; font-variant-numeric: tabular-nums }";

impl ModelSymmetryReport {
    /// Returns an HTML page that needs no other file: `title`, pictures of `model` in its initial
    /// configuration, and a table of the differences.
    ///
    /// # Errors
    /// [`ModelSymmetryError::Picture`] if the model cannot be drawn.
    pub fn html(&self, title: &str, model: &Arc<Model>) -> Result<String, ModelSymmetryError> {
        let title = xml_escaped(title);
        let plane = self.corrections.plane.unwrap_or_default();
        let mut page = format!(
            "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
             <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
             <title>{title}: left and right</title>\n<style>\n{STYLE}\n</style>\n</head>\n\
             <body>\n<main>\n<h1>{title}: left and right</h1>\n<div class=\"pictures\">\n"
        );
        let pictures = pictures(model, &plane).map_err(ModelSymmetryError::Picture)?;
        for (caption, png) in pictures {
            // writing to a String cannot fail
            let _ = writeln!(
                page,
                "<figure><img alt=\"{title}, {caption}\" width=\"{}\" height=\"{}\" \
                 src=\"data:image/png;base64,{}\"><figcaption>{caption}</figcaption></figure>",
                SIZE[0],
                SIZE[1],
                STANDARD.encode(png)
            );
        }
        page += "</div>\n";
        for fact in [Some(self.plane_text()), self.missing_text()].into_iter().flatten() {
            let _ = writeln!(page, "<p>{}</p>", xml_escaped(&fact));
        }
        if self.differences.is_empty() {
            page += "<p>no differences</p>\n";
        } else {
            self.add_table(&mut page);
        }
        page += "</main>\n</body>\n</html>\n";
        Ok(page)
    }

    fn add_table(&self, page: &mut String) {
        let _ = write!(
            page,
            "<p>Effect: root mean square (radians and metres) by which the joints of both sides are \
             apart after 1 s of mirrored torques, with this difference alone"
        );
        if let Some(twin) = self.twin_divergence {
            let _ = write!(page, "; {twin:.1e} for two copies of the left side");
        }
        *page += "; -: not simulated.</p>\n";
        *page += "<div class=\"wide\" tabindex=\"0\" role=\"region\" aria-label=\"Differences\">\n\
                  <table>\n<thead><tr><th scope=\"col\" class=\"number\">effect</th>\
                  <th scope=\"col\">objects</th><th scope=\"col\">property</th>\
                  <th scope=\"col\">difference</th><th scope=\"col\">mirror image</th>\
                  <th scope=\"col\">found</th></tr></thead>\n<tbody>\n";
        for difference in &self.differences {
            let cells = [
                difference.objects_text(),
                difference.property.to_string(),
                difference.amount_text(),
                MirrorDifference::numbers_text(&difference.expected),
                MirrorDifference::numbers_text(&difference.found),
            ];
            let _ = write!(page, "<tr><td class=\"number\">{}</td>", difference.effect_text());
            for cell in cells {
                let _ = write!(page, "<td>{}</td>", xml_escaped(&cell));
            }
            *page += "</tr>\n";
        }
        *page += "</tbody>\n</table>\n</div>\n";
    }
}

/// Draws the model in its initial configuration, along the mirror plane and from a side, as PNG files.
fn pictures(
    model: &Arc<Model>,
    plane: &MirrorPlane,
) -> Result<[(&'static str, Vec<u8>); 2], PictureError> {
    let [width, height] = SIZE;
    let mut renderer = Renderer::new(Arc::clone(model), width, height, RenderOptions::default())?;
    let mut data = Data::new(Arc::clone(model));
    data.forward()?;
    let sizes = &model.as_raw().stat;
    let normal = DVec3::from_array(plane.normal);
    // from the front of a robot that looks along x, whichever way the normal points
    let across = if normal.y < 0.0 { -normal } else { normal };
    let front = across.y.atan2(across.x) + FRAC_PI_2;
    let mut picture = |turn: f64, elevation: f64| {
        let camera = FreeCamera {
            target: sizes.center,
            distance: 1.4 * sizes.extent,
            azimuth: front + turn,
            elevation,
        };
        let mut image = vec![0; renderer.image_len()];
        renderer.render_from(&mut data, &camera, &mut image)?;
        let mut file = Vec::new();
        let mut encoder = png::Encoder::new(&mut file, width as u32, height as u32);
        encoder.set_color(png::ColorType::Rgb);
        encoder.write_header()?.write_image_data(&image)?;
        Ok::<_, PictureError>(file)
    };
    Ok([("along the mirror plane", picture(0.0, -0.1)?), ("from a side", picture(0.8, -0.4)?)])
}
