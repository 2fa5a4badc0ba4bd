//! The instances near a place, for rays that end near it.

use glam::Vec3;

/// Relative margin for the rounding of squared distances.
const ROUNDING: f32 = 1e-5;

/// The instances that a search found, with the centres and radii of their balls.
#[derive(Debug, Default)]
pub(crate) struct NearInstances {
    items: Vec<u32>,
    x: Vec<f32>,
    y: Vec<f32>,
    z: Vec<f32>,
    radius: Vec<f32>,
}

impl NearInstances {
    pub(crate) fn clear(&mut self) {
        self.items.clear();
        let Self { x, y, z, radius, .. } = self;
        [x, y, z, radius].into_iter().for_each(Vec::clear);
    }

    /// Adds an instance whose surface lies in a ball.
    pub(crate) fn push(&mut self, item: u32, center: Vec3, radius: f32) {
        self.items.push(item);
        self.x.push(center.x);
        self.y.push(center.y);
        self.z.push(center.z);
        self.radius.push(radius);
    }

    /// The instances above the plane through a place and within a distance of it, near ones first.
    pub(crate) fn above(&self, p: Vec3, normal: Vec3, distance: f32) -> Vec<BallFrom> {
        let mut found = Vec::new();
        for (i, &item) in self.items.iter().enumerate() {
            let (to_center, radius) = (Vec3::new(self.x[i], self.y[i], self.z[i]) - p, self.radius[i]);
            let length = to_center.length();
            // Rounding moves a ball by a fraction of its distance.
            let radius = radius + ROUNDING * (1.0 + length);
            if to_center.dot(normal) + radius >= 0.0 && length - radius <= distance {
                found.push(BallFrom { item, to_center, length, radius });
            }
        }
        found.sort_by(|a, b| (a.length - a.radius).total_cmp(&(b.length - b.radius)).then(a.item.cmp(&b.item)));
        found
    }
}

/// The ball around the surface of an instance, from a place.
#[derive(Debug, Clone, Copy)]
pub(crate) struct BallFrom {
    pub item: u32,
    to_center: Vec3,
    /// Length of `to_center`.
    length: f32,
    radius: f32,
}

impl BallFrom {
    /// Whether a ray at an angle to a unit axis with at least this cosine may intersect the ball.
    pub(crate) fn may_intersect(&self, axis: Vec3, cosine: f32) -> bool {
        let Self { to_center, length, radius, .. } = *self;
        if length <= radius {
            return true;
        }
        // The angle between the axis and the rim of the ball is the angle to its centre less its angular radius.
        let squared = length * length;
        let along = to_center.dot(axis);
        let (aside, tangent) = ((squared - along * along).max(0.0).sqrt(), (squared - radius * radius).sqrt());
        let (sine, nearest) = (aside * tangent - along * radius, along * tangent + aside * radius);
        sine <= 0.0 || nearest >= (cosine - ROUNDING) * squared
    }
}
