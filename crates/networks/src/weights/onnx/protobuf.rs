//! Protocol buffers, as far as ONNX files use them: fields by number, nothing assumed of their order.

/// The value of a field.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Value<'a> {
    Number(u64),
    /// A text, a list or a message.
    Bytes(&'a [u8]),
}

/// The fields of a message, by number; `None` where the bytes are no message.
pub fn fields(mut rest: &[u8]) -> Option<Vec<(u64, Value<'_>)>> {
    let mut fields = Vec::new();
    while !rest.is_empty() {
        let key = number(&mut rest)?;
        let value = match key & 7 {
            0 => Value::Number(number(&mut rest)?),
            1 => Value::Bytes(take(&mut rest, 8)?),
            2 => {
                let length = usize::try_from(number(&mut rest)?).ok()?;
                Value::Bytes(take(&mut rest, length)?)
            }
            5 => Value::Bytes(take(&mut rest, 4)?),
            _ => return None,
        };
        fields.push((key >> 3, value));
    }
    Some(fields)
}

/// The numbers of a list that is packed.
pub fn numbers(mut rest: &[u8]) -> Option<Vec<u64>> {
    let mut numbers = Vec::new();
    while !rest.is_empty() {
        numbers.push(number(&mut rest)?);
    }
    Some(numbers)
}

fn take<'a>(rest: &mut &'a [u8], count: usize) -> Option<&'a [u8]> {
    let (taken, left) = rest.split_at_checked(count)?;
    *rest = left;
    Some(taken)
}

/// Seven bits a byte, the lowest first.
fn number(rest: &mut &[u8]) -> Option<u64> {
    const BITS: u32 = 7;
    let mut number = 0;
    for shift in (0..u64::BITS).step_by(BITS as usize) {
        let byte = take(rest, 1)?[0];
        number |= u64::from(byte & 0x7f) << shift;
        if byte & 0x80 == 0 {
            return Some(number);
        }
    }
    None
}
