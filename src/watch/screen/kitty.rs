//! Pictures in whole pixels, over the half blocks, by the graphics protocol of the terminal kitty,
//! which Ghostty and WezTerm speak, too (<https://sw.kovidgoyal.net/kitty/graphics-protocol>).

use std::ffi::OsString;
use std::io::{self, Write};

use ratatui::layout::Rect;

use crate::base64::base64;
use crate::sheet::Picture;

/// Takes the picture away. Its number is any that no other program shows.
const REMOVE: &str = "\x1b_Ga=d,d=I,i=7071,q=2\x1b\\";
/// Most signs of one command.
const MOST: usize = 4096;

/// What a terminal shows in whole pixels: at most one picture.
pub struct Graphics {
    is_known: bool,
    last: Option<(Rect, Picture)>,
}

impl Graphics {
    /// For a terminal that says its name by these environment variables. One within tmux or screen
    /// has their name, and gets none.
    pub fn new(variable: impl Fn(&str) -> Option<OsString>) -> Self {
        let says = |name: &str, word: &str| {
            let value = variable(name).unwrap_or_default();
            value.to_string_lossy().to_lowercase().contains(word)
        };
        let by_name = says("TERM", "kitty") || says("TERM", "ghostty");
        Self {
            is_known: by_name || says("TERM_PROGRAM", "wezterm") && variable("TMUX").is_none(),
            last: None,
        }
    }

    /// Shows a picture in this part of the screen, or takes the last one away; nothing is written
    /// where nothing changes.
    ///
    /// # Errors
    /// What the terminal says.
    pub fn show(
        &mut self,
        picture: Option<(Rect, &Picture)>,
        out: &mut impl Write,
    ) -> io::Result<()> {
        let last = self.last.as_ref().map(|(area, picture)| (*area, picture));
        if !self.is_known || picture == last {
            return Ok(());
        }
        match picture {
            Some((area, picture)) => out.write_all(placed(area, picture).as_bytes())?,
            None => out.write_all(REMOVE.as_bytes())?,
        }
        out.flush()?;
        self.last = picture.map(|(area, picture)| (area, picture.clone()));
        Ok(())
    }
}

/// What puts a picture there, and leaves the cursor where it was.
fn placed(area: Rect, picture: &Picture) -> String {
    let (row, column) = (area.y + 1, area.x + 1);
    let mut text = format!("{REMOVE}\x1b7\x1b[{row};{column}H");
    let (width, height) = (picture.width, picture.height);
    let (columns, rows) = (area.width, area.height);
    let mut keys = format!("a=T,f=24,s={width},v={height},c={columns},r={rows},C=1,i=7071,q=2,");
    let data = base64(&picture.rgb);
    let mut rest = data.as_str();
    loop {
        let (part, next) = rest.split_at(rest.len().min(MOST));
        let more = u8::from(!next.is_empty());
        text.push_str(&format!("\x1b_G{keys}m={more};{part}\x1b\\"));
        // the keys stand in the first command alone
        keys.clear();
        rest = next;
        if rest.is_empty() {
            return text + "\x1b8";
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of_terminal(variables: &[(&str, &str)]) -> Graphics {
        let value = |name: &str| {
            let own = variables.iter().find(|(own, _)| *own == name);
            own.map(|(_, value)| OsString::from(value))
        };
        Graphics::new(value)
    }

    fn shown(graphics: &mut Graphics, picture: Option<(Rect, &Picture)>) -> String {
        let mut out = Vec::new();
        graphics.show(picture, &mut out).unwrap();
        String::from_utf8(out).unwrap()
    }

    /// A picture of 48 x 48 pixels.
    fn picture() -> Picture {
        Picture {
            width: 48,
            height: 48,
            rgb: (0..48 * 48 * 3).map(|i| (i % 251) as u8).collect(),
        }
    }

    const AREA: Rect = Rect::new(70, 20, 24, 12);

    #[test]
    fn terminals_that_know_pictures_are_known_by_their_names() {
        let known = |variables: &[(&str, &str)]| of_terminal(variables).is_known;
        assert!(known(&[("TERM", "xterm-kitty")]) && known(&[("TERM", "xterm-ghostty")]));
        let wezterm = ("TERM_PROGRAM", "WezTerm");
        assert!(known(&[("TERM", "xterm-256color"), wezterm]));
        assert!(!known(&[
            ("TERM", "tmux-256color"),
            wezterm,
            ("TMUX", "/tmp/tmux")
        ]));
        assert!(!known(&[("TERM", "xterm-256color")]) && !known(&[]));
    }

    #[test]
    fn a_picture_is_cut_into_commands_and_put_in_its_place() {
        let (picture, mut graphics) = (picture(), of_terminal(&[("TERM", "xterm-kitty")]));
        let text = shown(&mut graphics, Some((AREA, &picture)));
        let place = format!("{REMOVE}\x1b7\x1b[21;71H\x1b_G");
        let commands = text.strip_prefix(&place).unwrap();
        let commands = commands.strip_suffix("\x1b\\\x1b8").unwrap();
        let commands: Vec<_> = commands.split("\x1b\\\x1b_G").collect();
        let (keys, data): (Vec<_>, Vec<_>) = commands
            .iter()
            .filter_map(|command| command.split_once(';'))
            .unzip();
        let first = "a=T,f=24,s=48,v=48,c=24,r=12,C=1,i=7071,q=2,m=1";
        assert_eq!(keys, [first, "m=1", "m=0"]);
        assert!(
            data.iter()
                .all(|part| part.len() <= 4096 && part.len() % 4 == 0)
        );
        assert_eq!(data.concat(), base64(&picture.rgb));
    }

    #[test]
    fn nothing_is_written_where_nothing_changes() {
        let (picture, mut graphics) = (picture(), of_terminal(&[("TERM", "xterm-kitty")]));
        assert!(!shown(&mut graphics, Some((AREA, &picture))).is_empty());
        assert_eq!(shown(&mut graphics, Some((AREA, &picture))), "");
        let moved = Rect::new(60, 20, 24, 12);
        assert!(!shown(&mut graphics, Some((moved, &picture))).is_empty());
        assert_eq!(shown(&mut graphics, None), REMOVE);
        assert_eq!(shown(&mut graphics, None), "");
        let mut other = of_terminal(&[("TERM", "xterm")]);
        assert_eq!(shown(&mut other, Some((AREA, &picture))), "");
    }
}
