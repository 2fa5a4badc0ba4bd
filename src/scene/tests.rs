//! Scenes whose pictures are known in closed form.
