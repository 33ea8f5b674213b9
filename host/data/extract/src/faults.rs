//! What cannot be read of a file: the first of it in words, all of it counted.

/// A list of limited length.
#[derive(Clone, Debug)]
pub(crate) struct Faults {
    first: Vec<String>,
    count: u64,
    limit: usize,
}

impl Faults {
    /// An empty list that keeps the words of at most `limit`.
    pub(crate) fn new(limit: usize) -> Self {
        Self {
            first: Vec::new(),
            count: 0,
            limit,
        }
    }

    /// One more.
    pub(crate) fn add(&mut self, what: String) {
        self.count += 1;
        if self.first.len() < self.limit {
            self.first.push(what);
        }
    }

    /// How many there are.
    pub(crate) fn count(&self) -> u64 {
        self.count
    }

    /// The words of the first.
    pub(crate) fn first(&self) -> &[String] {
        &self.first
    }

    /// The words of the first, and how many there are beyond them, of a `kind`.
    pub(crate) fn words(&self, kind: &str) -> Vec<String> {
        let more = self.count - self.first.len() as u64;
        let more = (more > 0).then(|| format!("and {more} more {kind}"));
        self.first.iter().cloned().chain(more).collect()
    }
}
