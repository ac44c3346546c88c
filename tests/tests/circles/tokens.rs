//! Rust source as a list of words and signs, without comments and the contents of strings: as much of a lexer as paths need.

/// What a token is.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Kind {
    /// An identifier or a keyword; `r#` is taken off.
    Word(String),
    /// `::`
    PathSeparator,
    /// Any other sign, one character at a time.
    Sign(char),
    /// A string, number, character or lifetime.
    Other,
}

/// A token and the line it stands on, from 1.
#[derive(Clone, Debug)]
pub struct Token {
    /// What it is.
    pub kind: Kind,
    /// Line of the file, from 1.
    pub line: usize,
}

impl Token {
    /// Whether it is this word.
    pub fn is_word(&self, word: &str) -> bool {
        matches!(&self.kind, Kind::Word(w) if w == word)
    }

    /// Whether it is this sign.
    pub fn is(&self, sign: char) -> bool {
        self.kind == Kind::Sign(sign)
    }

    /// The word, where it is one.
    pub fn word(&self) -> Option<&str> {
        match &self.kind {
            Kind::Word(word) => Some(word),
            _ => None,
        }
    }
}

/// All tokens of a file. A string that is a path from `crate::` on, as serde's attributes hold, counts as that path.
pub fn tokens(text: &str) -> Vec<Token> {
    let mut lexer = Lexer {
        rest: text.chars().collect(),
        at: 0,
        line: 1,
        found: Vec::new(),
    };
    while lexer.step() {}
    lexer.found
}

struct Lexer {
    rest: Vec<char>,
    at: usize,
    line: usize,
    found: Vec<Token>,
}

impl Lexer {
    fn peek(&self, ahead: usize) -> Option<char> {
        self.rest.get(self.at + ahead).copied()
    }

    fn advance(&mut self) -> Option<char> {
        let c = self.peek(0)?;
        self.at += 1;
        self.line += usize::from(c == '\n');
        Some(c)
    }

    fn emit(&mut self, kind: Kind) {
        self.found.push(Token {
            kind,
            line: self.line,
        });
    }

    fn step(&mut self) -> bool {
        let Some(c) = self.peek(0) else { return false };
        match c {
            '/' if self.peek(1) == Some('/') => while self.advance().is_some_and(|c| c != '\n') {},
            '/' if self.peek(1) == Some('*') => self.block_comment(),
            '"' => self.string(),
            '\'' => self.quote(),
            ':' if self.peek(1) == Some(':') => {
                self.at += 2;
                self.emit(Kind::PathSeparator);
            }
            _ if c.is_whitespace() => {
                self.advance();
            }
            _ if c.is_ascii_digit() => {
                self.at += 1;
                self.word_characters();
                self.emit(Kind::Other);
            }
            _ if c == '_' || c.is_alphabetic() => self.word(),
            _ => {
                self.at += 1;
                self.emit(Kind::Sign(c));
            }
        }
        true
    }

    fn block_comment(&mut self) {
        let mut depth = 0;
        loop {
            match (self.peek(0), self.peek(1)) {
                (Some('/'), Some('*')) => {
                    depth += 1;
                    self.at += 2;
                }
                (Some('*'), Some('/')) => {
                    depth -= 1;
                    self.at += 2;
                    if depth == 0 {
                        return;
                    }
                }
                (Some(_), _) => {
                    self.advance();
                }
                (None, _) => return,
            }
        }
    }

    fn word_characters(&mut self) -> String {
        let mut word = String::new();
        while let Some(c) = self.peek(0).filter(|&c| c == '_' || c.is_alphanumeric()) {
            word.push(c);
            self.at += 1;
        }
        word
    }

    fn word(&mut self) {
        let word = self.word_characters();
        match (word.as_str(), self.peek(0)) {
            ("b" | "c", Some('"')) => self.string(),
            ("b", Some('\'')) => self.quote(),
            ("r" | "br" | "cr", Some('"' | '#')) => {
                let hashes = self.rest[self.at..].iter().take_while(|&&c| c == '#');
                let hashes = hashes.count();
                if self.peek(hashes) == Some('"') {
                    self.raw_string(hashes);
                } else {
                    // r#name: the sign is taken off, the name is the next word
                    self.at += hashes;
                }
            }
            _ => self.emit(Kind::Word(word)),
        }
    }

    fn raw_string(&mut self, hashes: usize) {
        self.at += hashes + 1;
        loop {
            match self.advance() {
                Some('"') if (0..hashes).all(|i| self.peek(i) == Some('#')) => break,
                Some(_) => {}
                None => break,
            }
        }
        self.at = (self.at + hashes).min(self.rest.len());
        self.emit(Kind::Other);
    }

    fn string(&mut self) {
        self.at += 1;
        let mut content = String::new();
        while let Some(c) = self.advance() {
            match c {
                '\\' => {
                    self.advance();
                }
                '"' => break,
                c => content.push(c),
            }
        }
        if content.starts_with("crate::") && !content.contains(char::is_whitespace) {
            let line = self.line;
            let path = tokens(&content).into_iter();
            self.found.extend(path.map(|t| Token { line, ..t }));
        } else {
            self.emit(Kind::Other);
        }
    }

    /// A character, or a lifetime, which has no closing quote.
    fn quote(&mut self) {
        self.at += 1;
        match (self.peek(0), self.peek(1)) {
            (Some('\\'), _) => {
                self.at += 2;
                while self.advance().is_some_and(|c| c != '\'') {}
            }
            (Some(_), Some('\'')) => {
                self.advance();
                self.at += 1;
            }
            _ => {
                self.word_characters();
            }
        }
        self.emit(Kind::Other);
    }
}

#[test]
fn comments_strings_and_lifetimes_hold_no_paths() {
    let text = r##"
        // crate::comment
        /* crate::a /* crate::b */ crate::c */
        fn f<'a>(x: &'a str) -> char { let _ = ("crate::text of words", r#"crate::raw "quoted""#, b'\'', '"'); crate::real }
        #[serde(with = "crate::attribute")]
        r#type
    "##;
    let found = tokens(text);
    let after_crate: Vec<_> = found
        .windows(3)
        .filter(|w| w[0].is_word("crate") && w[1].kind == Kind::PathSeparator)
        .filter_map(|w| w[2].word())
        .collect();
    assert_eq!(after_crate, ["real", "attribute"]);
    assert!(found.last().unwrap().is_word("type"));
    assert_eq!(found.last().unwrap().line, 6);
}
