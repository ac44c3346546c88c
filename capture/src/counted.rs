//! Numbers of things in words.

/// `1 message`, `2 messages`.
pub(crate) fn counted(count: u64, one: &str, many: &str) -> String {
    let name = if count == 1 { one } else { many };
    format!("{count} {name}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_is_no_plural() {
        let said = [0, 1, 2].map(|n| counted(n, "image", "images"));
        assert_eq!(said, ["0 images", "1 image", "2 images"]);
    }
}
