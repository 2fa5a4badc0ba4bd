//! Light at a point: rays past triangles, rays and cones through fields, occlusion, and indirect light.

pub(crate) mod bounces;
pub(crate) mod cone;
pub(crate) mod emitters;
pub(crate) mod far_field;
pub(crate) mod light_hits;
pub(crate) mod light_rays;
pub(crate) mod lit_surface;
pub(crate) mod mesh_rays;
pub(crate) mod near_instances;
pub(crate) mod occluder;
pub(crate) mod occlusion;
pub(crate) mod past_sheets;
pub(crate) mod ray_bundle;
pub(crate) mod shadow;
pub(crate) mod transmission;
