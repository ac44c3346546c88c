use lsfb_types::Image;

/// An image with corners, edges and texture.
pub(crate) fn pattern(width: u32, height: u32) -> Image {
    let value = |x: u32, y: u32| {
        let squares = x * x / 7 + 3 * x * y / 11 + y * y / 5;
        (squares + 90 * ((x / 16 + y / 16) % 2)) as u8
    };
    let rows = 0..height;
    Image {
        width,
        height,
        pixels: rows
            .flat_map(|y| (0..width).map(move |x| value(x, y)))
            .collect(),
        ..Image::default()
    }
}
