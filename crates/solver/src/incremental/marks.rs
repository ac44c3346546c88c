//! Sets of numbers that are emptied often.

/// Numbers, each once, in the order in which they came.
#[derive(Default)]
pub(super) struct Marks {
    is_in: Vec<bool>,
    all: Vec<usize>,
}

impl Marks {
    /// Adds a number; whether it is new.
    pub fn add(&mut self, number: usize) -> bool {
        if number >= self.is_in.len() {
            self.is_in.resize(number + 1, false);
        }
        let is_new = !std::mem::replace(&mut self.is_in[number], true);
        if is_new {
            self.all.push(number);
        }
        is_new
    }

    #[inline]
    pub fn has(&self, number: usize) -> bool {
        self.is_in.get(number) == Some(&true)
    }

    pub fn all(&self) -> &[usize] {
        &self.all
    }

    pub fn is_empty(&self) -> bool {
        self.all.is_empty()
    }

    pub fn retain(&mut self, mut keeps: impl FnMut(usize) -> bool) {
        let is_in = &mut self.is_in;
        self.all.retain(|number| {
            let kept = keeps(*number);
            is_in[*number] = kept;
            kept
        });
    }

    pub fn clear(&mut self) {
        for number in self.all.drain(..) {
            self.is_in[number] = false;
        }
    }
}
