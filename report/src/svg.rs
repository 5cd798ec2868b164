//! Drawings of curves as SVG 1.1, without scripts or embedded fonts.

use std::fmt::Write;

use experiments::colours::LineStyle;
use experiments::printable::escape_unprintable_lines;

/// SVG colour of lines and dots that belong to no task group: the colour of the text.
pub const TEXT_COLOUR: &str = "currentColor";

// All lengths are pixels of the view box.

/// Margins left of the panels, for names and ticks of the y axes, and right of them (pixels).
const SIDES: [f64; 2] = [64.0, 26.0];
/// Margins above the panels, for the legend, and below them, for the x axis (pixels).
const OUTSIDE: [f64; 2] = [34.0, 40.0];
/// Gap between two panels (pixels).
const GAP: f64 = 14.0;
/// Height of one row of the legend (pixels).
const LINE: f64 = 18.0;
/// Length of the sample line before a name in the legend (pixels).
const KEY: f64 = 28.0;
/// Space between a sample line of the legend and its name, and after the name (pixels).
const SPACE: f64 = 6.0;
/// Length of the line from the end of a curve to its name (pixels).
const LEADER: f64 = 16.0;
/// Least distance between two names at the ends of curves (pixels).
const NAME_HEIGHT: f64 = 13.0;
/// Radius of a dot (pixels).
pub const DOT_RADIUS: f64 = 3.5;
/// Radius of a dot where a panel has many (pixels).
pub const SMALL_DOT_RADIUS: f64 = 1.6;

/// SVG drawing of panels, one below the other, with a common x axis.
pub struct SvgPlot {
    /// SVG elements drawn so far.
    text: String,
    /// Largest value on the x axis, above 0.
    end: f64,
    /// Label of the x axis.
    axis: String,
    /// Length of the x axis (pixels).
    length: f64,
    /// Margins left and right of the panels (pixels).
    sides: [f64; 2],
    /// Top and height of the current panel (pixels).
    panel: [f64; 2],
    /// Values at the bottom and at the top of the current panel.
    bounds: [f64; 2],
    /// Position at which the next name of the legend begins (pixels).
    legend: [f64; 2],
}

impl SvgPlot {
    /// Creates a drawing over x from 0 to `end`, with a label for this axis, as wide as a page.
    pub fn new(end: f64, axis: &str) -> Self {
        Self {
            text: String::new(),
            // an axis of nothing has ticks, too
            end: if end > 0.0 { end } else { 1.0 },
            axis: axis.to_owned(),
            length: 880.0,
            sides: SIDES,
            panel: [OUTSIDE[0] - GAP, 0.0],
            bounds: [0.0, 1.0],
            legend: [SIDES[0], OUTSIDE[0] - 14.0],
        }
    }

    /// Sets the margins left and right of the panels (pixels), for texts of such a width, before
    /// anything is drawn.
    pub fn with_side_margins(mut self, sides: [f64; 2]) -> Self {
        self.sides = sides;
        self.legend[0] = sides[0];
        self
    }

    /// Creates a drawing of half a page's width, for two side by side.
    pub fn new_half_width(end: f64, axis: &str) -> Self {
        Self { length: 440.0, ..Self::new(end, axis) }
    }

    /// Begins a panel of `height` pixels below the last one, whose y axis spans `bounds`, with a
    /// name and ticks.
    pub fn begin_panel(&mut self, name: &str, height: f64, bounds: [f64; 2], ticks: &[f64]) {
        self.panel = [self.panel[0] + self.panel[1] + GAP, height];
        self.bounds = bounds;
        let top = self.panel[0];
        let ([left, _], width, middle) = (self.sides, self.length, top + height / 2.0);
        self.add(format_args!(
            "<rect x=\"{left}\" y=\"{top}\" width=\"{width}\" height=\"{height}\" class=\"frame\"/>\
             <text x=\"14\" y=\"{middle}\" transform=\"rotate(-90 14 {middle})\" class=\"name\">{}</text>",
            fitted(name, height + 2.0 * GAP)
        ));
        for &tick in ticks {
            self.add_row_label(tick, &tick.to_string());
        }
    }

    /// Writes a text left of the panel, at height `y` of its y axis.
    pub fn add_row_label(&mut self, y: f64, text: &str) {
        let (x, y) = (self.sides[0] - SPACE, self.y(y) + 4.0);
        let text = fitted(text, x);
        self.add(format_args!("<text x=\"{x}\" y=\"{y:.1}\" class=\"tick\">{text}</text>"));
    }

    /// Writes a text, such as a number, right of the panel, at height `y` of its y axis.
    pub fn add_row_value(&mut self, y: f64, text: &str) {
        let (x, y) = (self.sides[0] + self.length + SPACE, self.y(y) + 4.0);
        let text = fitted(text, self.sides[1] - SPACE);
        self.add(format_args!("<text x=\"{x}\" y=\"{y:.1}\" class=\"figure\">{text}</text>"));
    }

    /// Writes names of curves right of the panel, each with a line to the last point of its curve,
    /// if the panel is high enough for all of them.
    pub fn add_curve_labels(&mut self, curves: &[(&str, (f64, f64), &LineStyle)]) {
        let [top, height] = self.panel;
        if NAME_HEIGHT * curves.len() as f64 > height + NAME_HEIGHT {
            return;
        }
        let mut ends: Vec<_> = curves.iter().map(|curve| (self.y(curve.1.1), curve)).collect();
        ends.sort_by(|one, other| one.0.total_cmp(&other.0));
        // from the top: as near to the end as the name above allows; names that would lie below the
        // panel move up together with those that they meet
        let mut highest = top;
        for (y, _) in &mut ends {
            *y = y.max(highest);
            highest = *y + NAME_HEIGHT;
        }
        let mut lowest = top + height;
        for (y, _) in ends.iter_mut().rev() {
            *y = y.min(lowest);
            lowest = *y - NAME_HEIGHT;
        }
        let (edge, room) = (self.sides[0] + self.length, self.sides[1] - LEADER - SPACE);
        for (y, &(name, end, stroke)) in ends {
            let (from, to, x) = (self.x(end.0), self.y(end.1), edge + LEADER);
            self.add(format_args!(
                "<path d=\"M{from:.1} {to:.1}L{x} {y:.1}\" stroke=\"{}\" class=\"leader\"/>\
                 <text x=\"{}\" y=\"{:.1}\" class=\"figure\">{}</text>",
                stroke.colour,
                x + 3.0,
                y + 4.0,
                fitted(name, room)
            ));
        }
    }

    /// Fills the background of the panel between the x values `from` and `to`, with a title as
    /// tooltip.
    pub fn shade_span(&mut self, from: f64, to: f64, colour: &str, title: &str) {
        let ([top, height], x) = (self.panel, self.x(from));
        let width = self.x(to) - x;
        self.add(format_args!(
            "<rect x=\"{x:.1}\" y=\"{top}\" width=\"{width:.1}\" height=\"{height}\" fill=\"{colour}\" \
             fill-opacity=\"0.16\"><title>{}</title></rect>",
            escape_xml(title)
        ));
    }

    /// Adds a line through points to the panel.
    pub fn add_line(&mut self, points: &[(f64, f64)], stroke: &LineStyle) {
        self.polyline(points, stroke, "line");
    }

    /// Adds a line so wide that it shows on both sides of others that are drawn upon it.
    pub fn add_wide_line(&mut self, points: &[(f64, f64)], stroke: &LineStyle) {
        self.polyline(points, stroke, "line wide");
    }

    fn polyline(&mut self, points: &[(f64, f64)], stroke: &LineStyle, class: &str) {
        let (path, stroke) = (self.path(points.iter()), attributes(stroke));
        self.add(format_args!("<polyline points=\"{path}\" {stroke} class=\"{class}\"/>"));
    }

    /// Fills the area of the panel between two lines.
    pub fn add_band(&mut self, low: &[(f64, f64)], high: &[(f64, f64)], colour: &str) {
        // around the area: along the lower line, and back along the upper one
        let path = self.path(low.iter().chain(high.iter().rev()));
        self.add(format_args!("<polygon points=\"{path}\" fill=\"{colour}\" class=\"band\"/>"));
    }

    fn path<'a>(&self, points: impl Iterator<Item = &'a (f64, f64)>) -> String {
        let points = points.map(|&(x, y)| format!("{:.1},{:.1}", self.x(x), self.y(y)));
        points.collect::<Vec<_>>().join(" ")
    }

    /// Adds a dot at `point` with a radius in pixels, and a title as tooltip.
    pub fn add_dot(&mut self, point: (f64, f64), radius: f64, colour: &str, title: &str) {
        let (x, y) = (self.x(point.0), self.y(point.1));
        self.add(format_args!(
            "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"{radius}\" fill=\"{colour}\"><title>{}</title>\
             </circle>",
            escape_xml(title)
        ));
    }

    /// Adds a name and its stroke to the legend above the panels, which must be complete before the
    /// first [`Self::begin_panel`]. A name that does not fit into the last line begins a new one.
    pub fn add_legend_entry(&mut self, name: &str, stroke: &LineStyle) {
        let [left, right] = self.sides;
        let end = left + self.length + right;
        let room = end - left - KEY - 2.0 * SPACE;
        let width = KEY + 2.0 * SPACE + text_width(name).min(room);
        if self.legend[0] > left && self.legend[0] + width > end {
            self.legend = [left, self.legend[1] + LINE];
            self.panel[0] += LINE;
        }
        let ([x, y], stroke) = (self.legend, attributes(stroke));
        self.add(format_args!(
            "<path d=\"M{x} {y}h{KEY}\" {stroke} class=\"line key\"/>\
             <text x=\"{}\" y=\"{}\" class=\"legend\">{}</text>",
            x + KEY + SPACE,
            y + 4.5,
            fitted(name, room)
        ));
        self.legend[0] += width + SPACE;
    }

    /// Adds the x axis, and returns the SVG with a title for screen readers.
    pub fn into_svg(mut self, title: &str) -> String {
        let bottom = self.panel[0] + self.panel[1];
        for tick in ticks(self.end) {
            let (x, y) = (self.x(tick), bottom + 16.0);
            self.add(format_args!("<text x=\"{x:.1}\" y=\"{y}\" class=\"below\">{tick}</text>"));
        }
        let [left, right] = self.sides;
        let (middle, y) = (left + self.length / 2.0, bottom + 33.0);
        let axis = std::mem::take(&mut self.axis);
        self.add(format_args!("<text x=\"{middle}\" y=\"{y}\" class=\"below\">{axis}</text>"));
        let (width, height) = (left + self.length + right, bottom + OUTSIDE[1]);
        format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" role=\"img\" \
             font-family=\"sans-serif\" font-size=\"12\">\n<title>{}</title>\n<style>{STYLE}</style>\n\
             <rect width=\"100%\" height=\"100%\" class=\"paper\"/>\n{}</svg>\n",
            escape_xml(title),
            self.text
        )
    }

    fn x(&self, x: f64) -> f64 {
        self.sides[0] + x / self.end * self.length
    }

    fn y(&self, y: f64) -> f64 {
        let ([top, height], [low, high]) = (self.panel, self.bounds);
        top + height * (1.0 - (y - low) / (high - low))
    }

    fn add(&mut self, element: std::fmt::Arguments) {
        let _ = writeln!(self.text, "{element}");
    }
}

/// Style sheet of a drawing, which is light or dark by the reader's setting, alone and in a page.
const STYLE: &str = "svg{color:#1b1f24}.paper{fill:#fff}text{fill:currentColor}\
    .frame{fill:none;stroke:#888}.line{fill:none;stroke-width:1.6}.wide,.key{stroke-width:3.4}\
    .band{stroke:none;fill-opacity:0.2}.tick{text-anchor:end}.leader{fill:none}.name,.below{text-anchor:middle}\
    @media(prefers-color-scheme:dark){svg{color:#d6dbe0}.paper{fill:#16191d}}";

fn attributes(LineStyle { colour, dashes }: &LineStyle) -> String {
    let dashes = match dashes.as_str() {
        "" => String::new(),
        dashes => format!(" stroke-dasharray=\"{dashes}\""),
    };
    format!("stroke=\"{colour}\"{dashes}")
}

/// Returns an upper bound on the width of a text (pixels). The font is the viewer's, so characters
/// count as those of a wide font.
fn text_width(text: &str) -> f64 {
    let width = |character: char| match character {
        'm' | 'w' => 12.0,
        ' '..='@' | '_' | 'a'..='z' => 7.5,
        _ => 12.0,
    };
    text.chars().map(width).sum()
}

/// Returns a text as XML. A text wider than `room` (pixels) ends in an ellipsis, and the whole text
/// is its tooltip.
fn fitted(text: &str, room: f64) -> String {
    if text_width(text) <= room {
        return escape_xml(text);
    }
    let mut cut = String::new();
    for character in text.chars() {
        cut.push(character);
        if text_width(&cut) + text_width("…") > room {
            cut.pop();
            break;
        }
    }
    format!("{}…<title>{}</title>", escape_xml(&cut), escape_xml(text))
}

/// Returns two to eight round numbers from 0 to at most `end`, at equal steps of 1, 2 or 5 times a
/// power of ten.
fn ticks(end: f64) -> Vec<f64> {
    // eight ticks have seven steps between them
    let rough = end / 7.0;
    let exponent = rough.log10().floor() as i32;
    // 3 / 10 is the nearest number to 0.3, but 3 * 0.1 prints as 0.30000000000000004
    let multiple = |n: f64| match exponent {
        0.. => n * 10_f64.powi(exponent),
        _ => n / 10_f64.powi(-exponent),
    };
    let step =
        [1.0, 2.0, 5.0, 10.0].into_iter().find(|&step| multiple(step) >= rough).unwrap_or(10.0);
    let ticks = (0..=7).map(|n| multiple(f64::from(n) * step));
    // rounding must not remove the last tick
    ticks.take_while(|&tick| tick <= end * (1.0 + 1e-9)).collect()
}

/// Escapes the special characters of XML and HTML, and control characters, which XML does not
/// allow.
pub fn escape_xml(text: &str) -> String {
    let text = escape_unprintable_lines(text);
    let text = text.replace('&', "&amp;").replace('<', "&lt;");
    text.replace('>', "&gt;").replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    use super::read::check_texts;
    use super::*;
    use experiments::colours::curve_style;

    #[test]
    fn ticks_are_round_and_few() {
        assert_eq!(ticks(305_000.0), (0..=6).map(|n| 5e4 * f64::from(n)).collect::<Vec<_>>());
        assert_eq!(ticks(4.0), [0.0, 1.0, 2.0, 3.0, 4.0]);
        for end in [0.3, 0.5, 1.0, 7.0, 80.0, 999.0, 68_000.0, 1e6] {
            let ticks = ticks(end);
            assert!((2..=8).contains(&ticks.len()), "{end}");
            let labels = ticks.iter().map(f64::to_string);
            assert!(labels.clone().all(|label| label.len() <= 7), "{ticks:?}");
        }
        assert_eq!(ticks(0.3).last(), Some(&0.3));
    }

    #[test]
    fn points_lie_inside_their_panel() {
        let mut drawing = SvgPlot::new(100.0, "decisions");
        drawing.begin_panel("first", 100.0, [0.0, 1.0], &[0.0, 1.0]);
        drawing.begin_panel("a < b", 50.0, [0.0, 500.0], &[]);
        drawing.add_line(&[(0.0, 0.0), (100.0, 500.0)], &curve_style(0));
        let text = drawing.into_svg("two");
        // the second panel begins at 34 + 100 + 14 and is 50 high
        assert!(text.contains("points=\"64.0,198.0 944.0,148.0\""), "{text}");
        assert!(text.contains("a &lt; b") && text.ends_with("</svg>\n"));
    }
    #[test]
    fn names_of_any_length_lie_inside_the_drawing() {
        let long = "w".repeat(300);
        for names in [vec!["covers"; 3], vec!["a-rather-long-name"; 24], vec![long.as_str(); 2]] {
            let mut drawing = SvgPlot::new_half_width(1.0, "decisions");
            for (number, name) in names.iter().enumerate() {
                drawing.add_legend_entry(name, &curve_style(number));
            }
            drawing.begin_panel(names[0], 90.0, [0.0, 1.0], &[]);
            check_texts(&drawing.into_svg("names"), names.len());
        }
    }
}

/// Reader of the elements of a drawing, for tests.
#[cfg(test)]
pub(super) mod read {
    use super::text_width;

    /// Returns the tags of a drawing, each with the text up to the next one.
    pub fn tags(svg: &str) -> Vec<(&str, &str)> {
        let parts = svg.split('<').skip(1);
        parts.map(|part| part.split_once('>').unwrap()).collect()
    }

    /// Returns the value of an attribute.
    pub fn attribute<'a>(tag: &'a str, name: &str) -> Option<&'a str> {
        let (_, value) = tag.split_once(&format!(" {name}=\""))?;
        value.split('"').next()
    }

    pub fn number(tag: &str, name: &str) -> f64 {
        attribute(tag, name).unwrap().parse().unwrap()
    }

    /// Returns the tags of a class.
    pub fn of_class<'a>(svg: &'a str, class: &str) -> Vec<(&'a str, &'a str)> {
        let mut tags = tags(svg);
        tags.retain(|(tag, _)| attribute(tag, "class") == Some(class));
        tags
    }

    /// Asserts that the legend has `names` texts, all inside the view box and above the first
    /// panel, and that none covers another.
    pub fn check_texts(svg: &str, names: usize) {
        let view: Vec<f64> = attribute(svg, "viewBox")
            .unwrap()
            .split(' ')
            .map(|side| side.parse().unwrap())
            .collect();
        let frame = number(of_class(svg, "frame")[0].0, "y");
        let texts = of_class(svg, "legend");
        assert_eq!(texts.len(), names);
        let boxes: Vec<[f64; 3]> = texts
            .iter()
            .map(|(tag, text)| {
                let x = number(tag, "x");
                [x, x + text_width(text), number(tag, "y")]
            })
            .collect();
        for &[from, to, y] in &boxes {
            assert!(from >= 0.0 && to <= view[2] && y > 0.0 && y < frame, "{svg}");
        }
        for pair in boxes.windows(2) {
            let [[_, to, above], [from, _, below]] = [pair[0], pair[1]];
            assert!(to < from || above + 12.0 < below, "{pair:?}");
        }
        let [(tag, name), ..] = of_class(svg, "name")[..] else { panic!("{svg}") };
        assert!(number(tag, "y") - text_width(name) / 2.0 >= 0.0, "{name}");
    }
}
