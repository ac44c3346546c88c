use std::fmt::Write as _;

use super::World;

impl World {
    /// The surfaces as a PLY mesh with grey vertices, for viewers and reports.
    pub fn to_ply(&self) -> String {
        let polygons: Vec<Vec<[f32; 3]>> = self.facets().iter().map(|f| f.vertices()).collect();
        let vertices: usize = polygons.iter().map(Vec::len).sum();
        let mut text = format!(
            "ply\nformat ascii 1.0\nelement vertex {vertices}\nproperty float x\nproperty float y\nproperty float z\n\
             property uchar red\nproperty uchar green\nproperty uchar blue\nelement face {}\n\
             property list uchar int vertex_indices\nend_header\n",
            polygons.len()
        );
        for (facet, polygon) in polygons.iter().enumerate() {
            let grey = (255.0 * self.reflectance(facet)) as u8;
            for [x, y, z] in polygon {
                // Writing to a String cannot fail.
                let _ = writeln!(text, "{x} {y} {z} {grey} {grey} {grey}");
            }
        }
        let mut next = 0;
        for polygon in &polygons {
            let _ = write!(text, "{}", polygon.len());
            for _ in polygon {
                let _ = write!(text, " {next}");
                next += 1;
            }
            let _ = writeln!(text);
        }
        text
    }
}
