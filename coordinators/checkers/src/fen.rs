//! Reading positions: FEN as PDN 3.0 has it, such as `W:W21-32:B1-12` or `B:WK5,18:B9,K12.`

use crate::{
    board::{Colour, Position, bit},
    notation::{LONGEST, Numbering, TextError, read_square},
    rules::Variant,
};

impl Position {
    /// Reads a position: whose turn it is, then each side's squares, numbers, ranges or letters with digits, `K` before kings.
    /// White space may stand anywhere between the signs, a dot at the end. The word `start` is the variant's first position.
    ///
    /// # Errors
    /// What is wrong, with line and column.
    pub fn read(text: &str, variant: Variant, numbering: Numbering) -> Result<Self, TextError> {
        if text.trim() == "start" {
            return Ok(Self::start(variant.starts()));
        }
        if text.len() > LONGEST {
            let reason = format!("a position has at most {LONGEST} bytes");
            return Err(TextError::at(text, 0, reason));
        }
        Reader {
            text,
            at: 0,
            numbering,
        }
        .position()
    }
}

struct Reader<'a> {
    text: &'a str,
    at: usize,
    numbering: Numbering,
}

impl Reader<'_> {
    fn wrong<T>(&self, reason: impl Into<String>) -> Result<T, TextError> {
        Err(TextError::at(self.text, self.at, reason))
    }

    /// The next sign after white space.
    fn peek(&mut self) -> Option<char> {
        let rest = self.text.get(self.at..)?;
        let trimmed = rest.trim_start();
        self.at += rest.len() - trimmed.len();
        trimmed.chars().next()
    }

    fn eat(&mut self, sign: char) -> bool {
        let found = self.peek() == Some(sign);
        if found {
            self.at += sign.len_utf8();
        }
        found
    }

    fn colour(&mut self, what: &str) -> Result<Colour, TextError> {
        let colour = match self.peek() {
            Some('W' | 'w') => Colour::White,
            Some('B' | 'b') => Colour::Black,
            Some('?') => return self.wrong(format!("{what} must be known here: W or B, not `?`")),
            Some(other) => {
                let other = other.escape_debug();
                return self.wrong(format!("{what} is W or B, not `{other}`"));
            }
            None => return self.wrong(format!("{what} is missing: W or B")),
        };
        self.at += 1;
        Ok(colour)
    }

    fn colon(&mut self, before: &str) -> Result<(), TextError> {
        if self.eat(':') {
            return Ok(());
        }
        match self.peek() {
            Some(other) => {
                let other = other.escape_debug();
                self.wrong(format!("`{other}` stands where `:` and {before} should"))
            }
            None => self.wrong(format!("`:` and {before} are missing")),
        }
    }

    fn position(mut self) -> Result<Position, TextError> {
        let turn = self.colour("the side that moves")?;
        let mut position = Position {
            white: 0,
            black: 0,
            kings: 0,
            turn,
        };
        self.colon("the first side's pieces")?;
        let one = self.colour("the first side")?;
        self.list(&mut position, one)?;
        self.colon("the other side's pieces")?;
        self.peek();
        let at = self.at;
        let other = self.colour("the other side")?;
        if other == one {
            self.at = at;
            let name = one.name();
            return self.wrong(format!("{name}'s pieces stand here for the second time"));
        }
        self.list(&mut position, other)?;
        self.eat('.');
        match self.peek() {
            None => Ok(position),
            Some(more) => {
                let more = more.escape_debug();
                self.wrong(format!("`{more}` stands behind the position"))
            }
        }
    }

    fn list(&mut self, position: &mut Position, colour: Colour) -> Result<(), TextError> {
        if matches!(self.peek(), None | Some(':' | '.')) {
            return Ok(());
        }
        loop {
            let king = matches!(self.peek(), Some('K' | 'k'));
            self.at += usize::from(king);
            self.peek();
            let begin = self.at;
            let first = self.square()?;
            let last = if self.eat('-') {
                self.peek();
                self.square()?
            } else {
                first
            };
            self.put(position, colour, king, (first, last), begin)?;
            if !self.eat(',') {
                return Ok(());
            }
        }
    }

    fn square(&mut self) -> Result<u8, TextError> {
        let (square, behind) = read_square(self.text, self.at, self.numbering)?;
        self.at = behind;
        Ok(square)
    }

    /// Puts pieces on the squares from a number to another.
    fn put(
        &mut self,
        position: &mut Position,
        colour: Colour,
        king: bool,
        (first, last): (u8, u8),
        begin: usize,
    ) -> Result<(), TextError> {
        let numbering = self.numbering;
        let (first, last) = (numbering.number(first), numbering.number(last));
        let wrong = |reason: String| Err(TextError::at(self.text, begin, reason));
        if first > last {
            return wrong(format!("the range {first}-{last} runs backwards"));
        }
        for number in first..=last {
            let Some(square) = numbering.square(u32::from(number)) else {
                continue;
            };
            if let Some(there) = position.piece(square) {
                let whose = there.colour.name();
                return wrong(format!("square {number} has a piece of {whose} already"));
            }
            if !king && bit(square) & colour.crown_row() != 0 {
                let name = colour.name();
                return wrong(format!(
                    "a man of {name} cannot stand on {number}, where it would be a king: write K{number}"
                ));
            }
            match colour {
                Colour::White => position.white |= bit(square),
                Colour::Black => position.black |= bit(square),
            }
            if king {
                position.kings |= bit(square);
            }
        }
        Ok(())
    }
}
