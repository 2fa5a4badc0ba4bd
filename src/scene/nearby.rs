//! The instances near a place, for cones and rays that end near it.

use glam::Vec3;

/// Relative margin for the rounding of squared distances.
const ROUNDING: f32 = 1e-5;

/// The instances that a search found, with the centres and radii of their balls.
#[derive(Debug, Default)]
pub struct Nearby {
    pub items: Vec<u32>,
    x: Vec<f32>,
    y: Vec<f32>,
    z: Vec<f32>,
    radius: Vec<f32>,
}

impl Nearby {
    pub fn clear(&mut self) {
        self.items.clear();
        let Self { x, y, z, radius, .. } = self;
        [x, y, z, radius].into_iter().for_each(Vec::clear);
    }

    /// Adds an instance whose surface lies in a ball.
    pub fn push(&mut self, item: u32, center: Vec3, radius: f32) {
        self.items.push(item);
        self.x.push(center.x);
        self.y.push(center.y);
        self.z.push(center.z);
        self.radius.push(radius);
    }

    /// Ball `i`, as the vector from a point to its centre, and its radius.
    #[inline]
    pub fn ball_from(&self, i: usize, p: Vec3) -> (Vec3, f32) {
        (Vec3::new(self.x[i], self.y[i], self.z[i]) - p, self.radius[i])
    }

    /// The instances whose balls a ray with a unit direction may meet.
    pub fn along(&self, p: Vec3, direction: Vec3) -> impl Iterator<Item = u32> {
        let meets = move |&i: &usize| {
            let (way, radius) = self.ball_from(i, p);
            let (along, squared) = (way.dot(direction), way.length_squared());
            along >= -radius && squared - along * along <= radius * radius + ROUNDING * squared
        };
        (0..self.items.len()).filter(meets).map(move |i| self.items[i])
    }
}
