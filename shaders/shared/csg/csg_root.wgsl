// The first root of a field along a ray. Sphere tracing, with a minimum step, goes on until the field is below -ERODED.
// Then regula falsi, Illinois variant, refines the root between the last two points. Twin of `march` and `root` in
// src/csg/parts/trace.rs.
//
// The caller evaluates the field, at a single place of its text, because drivers inline the field at each call.

const SEARCHING: u32 = 0u;
const FOUND: u32 = 1u;
const MISSED: u32 = 2u;

struct RootSearch {
    // The t at which the caller must evaluate the field next. In the end it is the root.
    t: f32,
    // The bracket: the ray is outside at `low` and inside at `high`. `above` is negative until the field has been at
    // least -ERODED.
    low: f32,
    above: f32,
    high: f32,
    below: f32,
    is_bracketed: bool,
    last_side: i32,
    root_steps: u32,
}

fn search_from(start: f32) -> RootSearch {
    return RootSearch(start, start, -1.0, start, 0.0, false, 0, 0u);
}

// Continues with the value of the field at `t`. Returns SEARCHING, FOUND or MISSED.
fn search_on(search: ptr<function, RootSearch>, value: f32, inverse_lipschitz: f32, end: f32) -> u32 {
    var s = *search;
    if !s.is_bracketed && value >= -ERODED {
        let safe = value * inverse_lipschitz;
        // A safe step cannot cross a surface. The minimum step can.
        if s.t >= end || s.t + safe >= end { return MISSED; }
        // The bracket begins at the last point that is not inside the uneroded solid.
        if value >= 0.0 || s.above < 0.0 {
            s.low = s.t;
            s.above = max(value, 0.0);
        }
        s.t = min(s.t + max(safe, MIN_STEP), end);
        *search = s;
        return SEARCHING;
    }
    // The ray starts inside.
    if s.above < 0.0 { return FOUND; }
    if !s.is_bracketed {
        s.is_bracketed = true;
        s.high = s.t;
        s.below = value;
    } else if value > 0.0 {
        s.low = s.t;
        s.above = value;
        if s.last_side == 1 { s.below *= 0.5; }
        s.last_side = 1;
    } else {
        s.high = s.t;
        s.below = value;
        if s.last_side == -1 { s.above *= 0.5; }
        s.last_side = -1;
    }
    s.t = s.high;
    var state = SEARCHING;
    if s.root_steps == MAX_ROOT_STEPS || s.high - s.low <= ROOT_WIDTH * max(s.high, 1.0) || s.below == 0.0 {
        state = FOUND;
    } else {
        s.root_steps++;
        s.t = clamp(s.low + (s.high - s.low) * (s.above / (s.above - s.below)), s.low, s.high);
        // The next t is an end of the bracket: the root is exact to float32.
        if s.t == s.low || s.t == s.high { state = FOUND; }
    }
    *search = s;
    return state;
}
