//! Huffman codes of a JPEG, and its data bit by bit (ITU-T T.81, annexes B.2.4.2, F.2.2.3 and F.2.2.5).

/// Codes of so many bits are looked up at once.
const SHORT: u32 = 8;
/// The longest.
const LONGEST: u32 = 16;

/// A table of codes.
pub(super) struct Codes {
    /// By the next [`SHORT`] bits: length of the code and its symbol; length 0 where the code is longer.
    short: [(u8, u8); 1 << SHORT],
    /// By length: the first code that is too large for it, filled up to [`LONGEST`] bits, and what a code's symbol is at less the code.
    longer: [(u32, i32); LONGEST as usize + 1],
    symbols: Vec<u8>,
}

impl Codes {
    /// From how many codes each length has, and their symbols by rising code; `None` where there are more codes than bits can tell.
    pub fn new(counts: &[u8; LONGEST as usize], symbols: &[u8]) -> Option<Self> {
        let mut codes = Self {
            short: [(0, 0); 1 << SHORT],
            longer: [(0, 0); LONGEST as usize + 1],
            symbols: symbols.to_vec(),
        };
        let (mut code, mut at) = (0u32, 0usize);
        for length in 1..=LONGEST {
            let count = usize::from(counts[length as usize - 1]);
            let own = symbols.get(at..at + count)?;
            codes.longer[length as usize].1 = i32::try_from(at).ok()? - i32::try_from(code).ok()?;
            for symbol in own {
                if length <= SHORT {
                    let first = (code << (SHORT - length)) as usize;
                    let all = codes
                        .short
                        .get_mut(first..first + (1 << (SHORT - length)))?;
                    all.fill((length as u8, *symbol));
                }
                code += 1;
            }
            if code > 1 << length {
                return None;
            }
            codes.longer[length as usize].0 = code << (LONGEST - length);
            at += count;
            code <<= 1;
        }
        Some(codes)
    }

    /// Length and symbol of the code that these sixteen bits begin with.
    fn find(&self, bits: u32) -> Option<(u32, u8)> {
        let (length, symbol) = self.short[(bits >> (LONGEST - SHORT)) as usize];
        if length > 0 {
            return Some((u32::from(length), symbol));
        }
        let length = (SHORT + 1..=LONGEST).find(|n| bits < self.longer[*n as usize].0)?;
        let code = (bits >> (LONGEST - length)) as i32;
        let at = usize::try_from(self.longer[length as usize].1 + code).ok()?;
        Some((length, *self.symbols.get(at)?))
    }
}

/// Why data do not go on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Stop {
    /// A marker, or the end of the file, comes first.
    Ended,
    /// No code begins like this.
    NoCode,
}

/// The data of a scan from a place in a file up to the next marker.
pub(super) struct Bits<'a> {
    bytes: &'a [u8],
    /// The next byte that is not in `buffer`.
    at: usize,
    buffer: u64,
    /// Bits in it, the next one highest.
    count: u32,
}

impl<'a> Bits<'a> {
    pub fn new(bytes: &'a [u8], at: usize) -> Self {
        Self {
            bytes,
            at,
            buffer: 0,
            count: 0,
        }
    }

    /// The next byte of data and how many of the file it takes; `None` at a marker.
    fn next_byte(&self) -> Option<(u8, usize)> {
        match self.bytes.get(self.at..)? {
            [0xff, 0, ..] => Some((0xff, 2)),
            [0xff, ..] | [] => None,
            [byte, ..] => Some((*byte, 1)),
        }
    }

    fn fill(&mut self) {
        while self.count <= 56 {
            let Some((byte, taken)) = self.next_byte() else {
                return;
            };
            self.buffer |= u64::from(byte) << (56 - self.count);
            self.count += 8;
            self.at += taken;
        }
    }

    fn skip(&mut self, bits: u32) -> Result<(), Stop> {
        if bits > self.count {
            return Err(Stop::Ended);
        }
        self.buffer <<= bits;
        self.count -= bits;
        Ok(())
    }

    /// The symbol of the next code.
    pub fn symbol(&mut self, codes: &Codes) -> Result<u8, Stop> {
        if self.count < LONGEST {
            self.fill();
        }
        let found = codes.find((self.buffer >> 48) as u32);
        match found {
            Some((length, symbol)) => self.skip(length).map(|()| symbol),
            // The last bits are filled up with ones, which are the beginning of no code.
            None if self.count < LONGEST => Err(Stop::Ended),
            None => Err(Stop::NoCode),
        }
    }

    /// So many bits as they are, at most 16.
    pub fn value(&mut self, bits: u32) -> Result<u32, Stop> {
        if bits == 0 {
            return Ok(0);
        }
        if self.count < bits {
            self.fill();
        }
        let value = (self.buffer >> (64 - bits)) as u32;
        self.skip(bits).map(|()| value)
    }

    /// Where the next marker is, and the whole bytes of data before it that were not read.
    pub fn rest(mut self) -> (usize, Vec<u8>) {
        let mut rest = Vec::new();
        self.skip(self.count % 8).ok();
        while self.count > 0 {
            rest.push((self.buffer >> 56) as u8);
            self.skip(8).ok();
        }
        while let Some((byte, taken)) = self.next_byte() {
            rest.push(byte);
            self.at += taken;
        }
        (self.at, rest)
    }
}
