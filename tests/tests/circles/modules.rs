//! The modules of one crate: what each declares, imports and names by path. What is compiled for tests alone is left out.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use crate::tokens::{Kind, Token, tokens};

/// Index of a module in [`Modules`].
pub type Id = usize;

/// One import: `use path::name`, or `use path::*` where the name is empty.
#[derive(Clone, Debug)]
pub struct Import {
    /// What it is called here; `None` for a glob.
    pub name: Option<String>,
    /// Where it comes from.
    pub path: Vec<String>,
}

/// A path in the text of a module.
#[derive(Clone, Debug)]
pub struct Mention {
    /// Its segments.
    pub path: Vec<String>,
    /// Line of the file, from 1.
    pub line: usize,
}

/// One module.
#[derive(Debug, Default)]
pub struct Module {
    /// Its name; `crate` for the root.
    pub name: String,
    /// The module around it.
    pub parent: Option<Id>,
    /// The modules it declares.
    pub children: Vec<Id>,
    /// Its file.
    pub file: PathBuf,
    /// Names of its own items.
    pub items: BTreeSet<String>,
    /// Its `use` declarations, those inside functions too.
    pub imports: Vec<Import>,
    /// Every path it names, those of `use` declarations too.
    pub mentions: Vec<Mention>,
    /// Every word in it and the line of its first occurrence: what a glob import may bring.
    pub words: Vec<(String, usize)>,
}

/// All modules of a crate; the first is its root.
#[derive(Debug, Default)]
pub struct Modules(pub Vec<Module>);

impl Modules {
    /// Those of the crate whose root file is given (`lib.rs`, `main.rs`).
    pub fn read(root: &Path) -> Self {
        let mut modules = Self::default();
        modules.add_file("crate", None, root);
        modules
    }

    /// `a::b` from the root.
    pub fn path_of(&self, id: Id) -> String {
        let mut names = Vec::new();
        let mut at = Some(id);
        while let Some(module) = at.map(|id| &self.0[id]) {
            names.push(module.name.as_str());
            at = module.parent;
        }
        names.reverse();
        names.join("::")
    }

    /// The child of that name.
    pub fn child(&self, id: Id, name: &str) -> Option<Id> {
        let children = self.0[id].children.iter().copied();
        children.into_iter().find(|&c| self.0[c].name == name)
    }

    fn add_file(&mut self, name: &str, parent: Option<Id>, file: &Path) {
        let text = std::fs::read_to_string(file)
            .unwrap_or_else(|error| panic!("{}: {error}", file.display()));
        self.add(name, parent, file, &tokens(&text));
    }

    /// Adds a module from the tokens of its body.
    pub fn add(&mut self, name: &str, parent: Option<Id>, file: &Path, body: &[Token]) {
        let id = self.0.len();
        self.0.push(Module {
            name: name.to_owned(),
            parent,
            file: file.to_owned(),
            ..Module::default()
        });
        if let Some(parent) = parent {
            self.0[parent].children.push(id);
        }
        let mut reader = BodyReader {
            modules: self,
            id,
            body,
            at: 0,
        };
        reader.read();
    }
}

struct BodyReader<'a> {
    modules: &'a mut Modules,
    id: Id,
    body: &'a [Token],
    at: usize,
}

impl BodyReader<'_> {
    fn read(&mut self) {
        let mut depth = 0_usize;
        while let Some(token) = self.body.get(self.at) {
            if token.is('#') && self.is_for_tests() {
                self.skip_item();
                continue;
            }
            match &token.kind {
                Kind::Sign('{') => depth += 1,
                Kind::Sign('}') => depth = depth.saturating_sub(1),
                Kind::Word(word) if word == "use" => {
                    self.at += 1;
                    self.import(Vec::new());
                    continue;
                }
                Kind::Word(word) if word == "mod" && depth == 0 => {
                    self.declaration();
                    continue;
                }
                Kind::Word(word) => {
                    if depth == 0 && DECLARES.contains(&word.as_str()) {
                        self.item();
                    }
                    self.mention();
                    continue;
                }
                _ => {}
            }
            self.at += 1;
        }
    }

    /// Whether an attribute here switches what follows on for tests alone.
    fn is_for_tests(&self) -> bool {
        let head: Vec<_> = self.body[self.at..].iter().take(6).collect();
        matches!(head.as_slice(), [_, open, cfg, paren, test, close]
            if open.is('[') && cfg.is_word("cfg") && paren.is('(') && test.is_word("test") && close.is(')'))
            || matches!(head.as_slice(), [_, open, test, close, ..]
                if open.is('[') && test.is_word("test") && close.is(']'))
    }

    /// To behind the item that begins here with its attributes.
    fn skip_item(&mut self) {
        let mut depth = 0_usize;
        let mut is_import = false;
        while let Some(token) = self.body.get(self.at) {
            self.at += 1;
            match token.kind {
                Kind::Sign('{' | '(' | '[') => depth += 1,
                Kind::Sign('}' | ')' | ']') => {
                    depth = depth.saturating_sub(1);
                    if depth == 0 && token.is('}') && !is_import {
                        return;
                    }
                }
                Kind::Sign(';') if depth == 0 => return,
                _ => is_import |= depth == 0 && token.is_word("use"),
            }
        }
    }

    /// `mod name;` or `mod name { .. }`.
    fn declaration(&mut self) {
        self.at += 1;
        let Some(name) = self.body.get(self.at).and_then(Token::word) else {
            return;
        };
        let name = name.to_owned();
        self.at += 1;
        let file = self.modules.0[self.id].file.clone();
        if self.body.get(self.at).is_some_and(|t| t.is('{')) {
            let begin = self.at + 1;
            self.skip_item();
            let end = (self.at - 1).max(begin);
            self.modules
                .add(&name, Some(self.id), &file, &self.body[begin..end]);
            return;
        }
        let folder = file.parent().unwrap_or(Path::new("."));
        let plain = folder.join(format!("{name}.rs"));
        let file = if plain.exists() {
            plain
        } else {
            folder.join(&name).join("mod.rs")
        };
        self.modules.add_file(&name, Some(self.id), &file);
    }

    /// The name of the item declared here.
    fn item(&mut self) {
        let after = self.body[self.at + 1..].iter().filter_map(Token::word);
        let mut after = after.filter(|w| !DECLARES.contains(w) && *w != "mut");
        if let Some(name) = after.next() {
            self.modules.0[self.id].items.insert(name.to_owned());
        }
    }

    /// The tree of a `use`, with what stands before it.
    fn import(&mut self, mut path: Vec<String>) {
        let mut name = None;
        while let Some(token) = self.body.get(self.at) {
            match &token.kind {
                Kind::Word(word) if word == "as" => {
                    self.at += 1;
                    name = self.body.get(self.at).and_then(Token::word);
                    self.at += 1;
                }
                Kind::Word(word) => {
                    path.push(word.clone());
                    self.at += 1;
                }
                Kind::PathSeparator => self.at += 1,
                Kind::Sign('*') => {
                    self.at += 1;
                    self.add_import(None, path, token.line);
                    return;
                }
                Kind::Sign('{') => {
                    self.at += 1;
                    while self.body.get(self.at).is_some_and(|t| !t.is('}')) {
                        self.import(path.clone());
                        if self.body.get(self.at).is_some_and(|t| t.is(',')) {
                            self.at += 1;
                        }
                    }
                    self.at += 1;
                    return;
                }
                _ => break,
            }
        }
        let line = self.body[self.at.saturating_sub(1)].line;
        if path.len() > 1 && path.last().is_some_and(|p| p == "self") {
            path.pop();
        }
        let name = name.map(str::to_owned).or_else(|| path.last().cloned());
        if name.is_some() {
            self.add_import(name, path, line);
        } else {
            self.at += 1;
        }
    }

    fn add_import(&mut self, name: Option<String>, path: Vec<String>, line: usize) {
        let module = &mut self.modules.0[self.id];
        module.mentions.push(Mention {
            path: path.clone(),
            line,
        });
        module.imports.push(Import { name, path });
    }

    /// The path, or the single word, that begins here.
    fn mention(&mut self) {
        let line = self.body[self.at].line;
        let mut path = Vec::new();
        while let Some(word) = self.body.get(self.at).and_then(Token::word) {
            path.push(word.to_owned());
            self.at += 1;
            let goes_on = self.body.get(self.at..self.at + 2);
            match goes_on {
                Some([sep, word]) if sep.kind == Kind::PathSeparator && word.word().is_some() => {
                    self.at += 1;
                }
                _ => break,
            }
        }
        let module = &mut self.modules.0[self.id];
        if let [word] = path.as_slice() {
            if !module.words.iter().any(|(known, _)| known == word) {
                module.words.push((word.clone(), line));
            }
        } else {
            module.mentions.push(Mention { path, line });
        }
    }
}

const DECLARES: &[&str] = &[
    "struct", "enum", "union", "fn", "trait", "type", "const", "static",
];
