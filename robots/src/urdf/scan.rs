//! Tags of an XML text, read more strictly than XML asks for: whatever is accepted here, all
//! parsers read alike.

/// What an XML text is made of, comments aside.
pub(super) enum Piece<'a> {
    /// Characters between tags.
    Text(&'a str),
    Tag(Tag<'a>),
}

#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    Start,
    End,
    /// Start and end in one.
    Empty,
}

pub(super) struct Tag<'a> {
    pub(super) kind: Kind,
    pub(super) name: &'a str,
    /// Names and values; entities in the values are still escaped.
    pub(super) attributes: Vec<[&'a str; 2]>,
}

/// The pieces of a text in their order. After an error nothing that follows means anything.
pub(super) struct Pieces<'a> {
    text: &'a str,
    rest: &'a str,
    /// The text from the piece on that was read last.
    last: &'a str,
}

const BLANKS: [char; 4] = [' ', '\t', '\r', '\n'];

impl<'a> Pieces<'a> {
    /// The pieces that follow the XML declaration, if there is one.
    pub(super) fn new(text: &'a str) -> Self {
        let rest = text.trim_start_matches('\u{feff}').trim_start();
        let declared = rest.strip_prefix("<?xml");
        let end = declared.and_then(|inside| inside.split_once('>'));
        let end = end.filter(|(inside, _)| inside.ends_with('?'));
        let rest = end.map_or(rest, |(_, rest)| rest);
        Self {
            text,
            rest,
            last: rest,
        }
    }

    /// Line of the text (from one) at which the next piece starts.
    pub(super) fn line(&self) -> usize {
        self.line_of(self.rest)
    }

    /// Line of the text (from one) at which the piece starts that was read last.
    pub(super) fn first_line(&self) -> usize {
        self.line_of(self.last)
    }

    fn line_of(&self, rest: &str) -> usize {
        let read = &self.text[..self.text.len() - rest.len()];
        read.matches('\n').count() + 1
    }

    fn piece(&mut self) -> Result<Piece<'a>, String> {
        if !self.rest.starts_with('<') {
            let text = self.take(|character| character != '<');
            return Ok(Piece::Text(text));
        }
        self.tag().map(Piece::Tag)
    }

    fn skip_comments(&mut self) -> Result<(), String> {
        while let Some(comment) = self.rest.strip_prefix("<!--") {
            let end = comment.split_once("-->");
            (_, self.rest) = end.ok_or("a comment has no end")?;
        }
        Ok(())
    }

    fn tag(&mut self) -> Result<Tag<'a>, String> {
        self.skip("<");
        if self.rest.starts_with(['!', '?']) {
            let reason = "only comments and one leading `<?xml ... ?>` may start with `<!` or `<?`";
            return Err(reason.to_owned());
        }
        let closes = self.skip("/");
        let name = self.name()?;
        let attributes = if closes {
            Vec::new()
        } else {
            self.attributes()?
        };
        self.take(|character| BLANKS.contains(&character));
        let kind = match closes {
            true => Kind::End,
            false if self.skip("/") => Kind::Empty,
            false => Kind::Start,
        };
        let tag = Tag {
            kind,
            name,
            attributes,
        };
        self.skip(">")
            .then_some(tag)
            .ok_or_else(|| format!("the tag `{name}` has no end"))
    }

    fn attributes(&mut self) -> Result<Vec<[&'a str; 2]>, String> {
        let mut attributes = Vec::new();
        loop {
            self.take(|character| BLANKS.contains(&character));
            if self.rest.is_empty() || self.rest.starts_with(['/', '>']) {
                return Ok(attributes);
            }
            attributes.push([self.name()?, self.value()?]);
        }
    }

    /// A name with a prefix at most.
    fn name(&mut self) -> Result<&'a str, String> {
        let is_part = |character: char| character.is_alphanumeric() || "_-.:".contains(character);
        let name = self.take(is_part);
        let mut parts = name.split(':');
        if parts.all(|part| !part.is_empty()) && name.matches(':').count() < 2 {
            return Ok(name);
        }
        Err("a tag or an attribute has no name that XML allows".to_owned())
    }

    fn value(&mut self) -> Result<&'a str, String> {
        self.take(|character| BLANKS.contains(&character));
        let equals = self.skip("=");
        self.take(|character| BLANKS.contains(&character));
        let quote = self
            .rest
            .chars()
            .next()
            .filter(|quote| "\"'".contains(*quote));
        let Some(quote) = quote.filter(|_| equals) else {
            return Err("an attribute has no value in quotes".to_owned());
        };
        let inside = &self.rest[1..];
        let (value, rest) = inside.split_once(quote).ok_or("a quote has no end")?;
        if value.contains('<') {
            return Err("a value holds `<`; write `&lt;`".to_owned());
        }
        self.rest = rest;
        Ok(value)
    }

    /// The characters up to the first one that does not belong.
    fn take(&mut self, belongs: impl Fn(char) -> bool) -> &'a str {
        let end = self.rest.find(|character| !belongs(character));
        let (taken, rest) = self.rest.split_at(end.unwrap_or(self.rest.len()));
        self.rest = rest;
        taken
    }

    /// Whether a token comes next, which is skipped then.
    fn skip(&mut self, token: &str) -> bool {
        let rest = self.rest.strip_prefix(token);
        self.rest = rest.unwrap_or(self.rest);
        rest.is_some()
    }
}

impl<'a> Iterator for Pieces<'a> {
    type Item = Result<Piece<'a>, String>;

    fn next(&mut self) -> Option<Self::Item> {
        if let Err(reason) = self.skip_comments() {
            return Some(Err(reason));
        }
        self.last = self.rest;
        (!self.rest.is_empty()).then(|| self.piece())
    }
}
