//! Which module uses which, and the circles among modules that lie side by side.

use std::collections::{BTreeMap, BTreeSet};

use crate::modules::{Id, Modules};

/// One module uses another.
#[derive(Clone, Debug)]
pub struct Use {
    /// How often.
    pub count: usize,
    /// One place, `file:line`, and the path that is named there.
    pub example: String,
}

/// What was looked up on the way to one answer: imports may lead in circles.
type Asked = BTreeSet<(Id, Vec<String>)>;

/// Modules below one parent that use each other in a circle, each with all that lies below it.
#[derive(Debug)]
pub struct Circle {
    /// Path of the parent.
    pub parent: String,
    /// Names of the modules.
    pub members: BTreeSet<String>,
    /// Who uses whom among them.
    pub uses: BTreeMap<(String, String), Use>,
}

impl Modules {
    /// All circles between modules that have one parent. A child may use what its parent holds, and a parent its children.
    pub fn circles(&self) -> Vec<Circle> {
        let mut siblings: BTreeMap<Id, BTreeMap<(Id, Id), Use>> = BTreeMap::new();
        for (from, to, example) in self.all_uses() {
            if let Some((parent, a, b)) = self.side_by_side(from, to) {
                let uses = siblings.entry(parent).or_default();
                let entry = uses.entry((a, b)).or_insert(Use { count: 0, example });
                entry.count += 1;
            }
        }
        siblings
            .iter()
            .flat_map(|(&parent, uses)| self.circles_below(parent, uses))
            .collect()
    }

    fn circles_below(&self, parent: Id, uses: &BTreeMap<(Id, Id), Use>) -> Vec<Circle> {
        let children = &self.0[parent].children;
        let reached: BTreeMap<Id, BTreeSet<Id>> =
            children.iter().map(|&c| (c, reach(c, uses))).collect();
        let mut circles = Vec::new();
        let mut done = BTreeSet::new();
        for &child in children {
            let members: BTreeSet<Id> = reached[&child]
                .iter()
                .copied()
                .filter(|other| reached[other].contains(&child))
                .collect();
            if members.len() < 2 || !done.insert(members.clone()) {
                continue;
            }
            let name = |id: Id| self.0[id].name.clone();
            circles.push(Circle {
                parent: self.path_of(parent),
                members: members.iter().map(|&m| name(m)).collect(),
                uses: uses
                    .iter()
                    .filter(|((a, b), _)| members.contains(a) && members.contains(b))
                    .map(|((a, b), u)| ((name(*a), name(*b)), u.clone()))
                    .collect(),
            });
        }
        circles
    }

    /// Every use of one module by another, with an example of it.
    fn all_uses(&self) -> Vec<(Id, Id, String)> {
        let mut found = Vec::new();
        for (id, module) in self.0.iter().enumerate() {
            let place = |line: usize, path: &[String]| {
                format!("{}:{line} {}", module.file.display(), path.join("::"))
            };
            for mention in &module.mentions {
                for target in self.resolve(id, &mention.path) {
                    found.push((id, target, place(mention.line, &mention.path)));
                }
            }
            for (word, line) in &module.words {
                let imported = module.imports.iter().any(|i| i.name.as_ref() == Some(word));
                if imported || module.items.contains(word) {
                    continue;
                }
                for target in self.through_globs(id, word, &mut Asked::new()) {
                    found.push((id, target, place(*line, std::slice::from_ref(word))));
                }
            }
        }
        found
    }

    /// The modules in which what a path names may be declared; none where it is of another crate.
    fn resolve(&self, from: Id, path: &[String]) -> BTreeSet<Id> {
        let mut found = BTreeSet::new();
        self.resolve_into(from, path, &mut Asked::new(), &mut found);
        found
    }

    fn resolve_into(&self, from: Id, path: &[String], asked: &mut Asked, found: &mut BTreeSet<Id>) {
        if !asked.insert((from, path.to_vec())) {
            return;
        }
        let mut at = from;
        let mut rest = path;
        while let [first, tail @ ..] = rest {
            match first.as_str() {
                "crate" => at = 0,
                "self" => {}
                "super" => at = self.0[at].parent.unwrap_or(0),
                _ => break,
            }
            rest = tail;
        }
        let is_relative = rest.len() == path.len();
        self.walk(at, rest, is_relative, asked, found);
    }

    /// Follows the segments down from a module. A relative path that nothing here knows is of another crate.
    fn walk(
        &self,
        mut at: Id,
        path: &[String],
        is_relative: bool,
        asked: &mut Asked,
        found: &mut BTreeSet<Id>,
    ) {
        for (i, segment) in path.iter().enumerate() {
            if let Some(child) = self.child(at, segment) {
                at = child;
                continue;
            }
            let mut known = self.0[at].items.contains(segment);
            for import in &self.0[at].imports {
                match &import.name {
                    Some(name) if name == segment => {
                        known = true;
                        let mut whole = import.path.clone();
                        whole.extend_from_slice(&path[i + 1..]);
                        self.resolve_into(at, &whole, asked, found);
                    }
                    _ => {}
                }
            }
            if !known {
                let through = self.through_globs(at, segment, asked);
                known = !through.is_empty();
                found.extend(through);
            }
            if self.0[at].items.contains(segment) || !(known || is_relative && i == 0) {
                found.insert(at);
            }
            return;
        }
        found.insert(at);
    }

    /// The modules of which a word may be that a module sees through its glob imports.
    fn through_globs(&self, at: Id, word: &str, asked: &mut Asked) -> BTreeSet<Id> {
        let mut found = BTreeSet::new();
        if !asked.insert((at, vec!["*".to_owned(), word.to_owned()])) {
            return found;
        }
        for import in self.0[at].imports.iter().filter(|i| i.name.is_none()) {
            let mut sources = BTreeSet::new();
            self.resolve_into(at, &import.path, asked, &mut sources);
            for source in sources {
                let module = &self.0[source];
                if let Some(child) = self.child(source, word) {
                    found.insert(child);
                } else if module.items.contains(word) {
                    found.insert(source);
                } else if let Some(i) = module
                    .imports
                    .iter()
                    .find(|i| i.name.as_deref() == Some(word))
                {
                    self.resolve_into(source, &i.path, asked, &mut found);
                } else {
                    found.extend(self.through_globs(source, word, asked));
                }
            }
        }
        found
    }

    /// The nearest module around both, and its children that hold one each; `None` where one lies around the other.
    fn side_by_side(&self, from: Id, to: Id) -> Option<(Id, Id, Id)> {
        let (a, b) = (self.lineage(from), self.lineage(to));
        let shared = a.iter().zip(&b).take_while(|(a, b)| a == b).count();
        Some((a[shared - 1], *a.get(shared)?, *b.get(shared)?))
    }

    /// From the root down to the module.
    fn lineage(&self, id: Id) -> Vec<Id> {
        let mut line = vec![id];
        while let Some(parent) = self.0[line[line.len() - 1]].parent {
            line.push(parent);
        }
        line.reverse();
        line
    }
}

fn reach(from: Id, uses: &BTreeMap<(Id, Id), Use>) -> BTreeSet<Id> {
    let mut reached = BTreeSet::new();
    let mut open = vec![from];
    while let Some(id) = open.pop() {
        for (_, to) in uses.keys().filter(|(a, _)| *a == id) {
            if reached.insert(*to) {
                open.push(*to);
            }
        }
    }
    reached
}
