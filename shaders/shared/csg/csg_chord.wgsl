// Intersections of a line with a part in closed form. Twin of src/csg/parts/chord.rs, function by function. The theory
// is there.

#import csg_leaves
#import csg_needs
#import csg_root

// The whole line and the empty chord, as (t_from, t_to).
const WHOLE_LINE = vec2f(-CHORD_FAR, CHORD_FAR);
const NO_CHORD = vec2f(CHORD_FAR, -CHORD_FAR);

fn both(a: vec2f, b: vec2f) -> vec2f {
    return vec2f(max(a.x, b.x), min(a.y, b.y));
}

// The smallest chord that contains both. The two are pieces of one convex solid.
fn hull(a: vec2f, b: vec2f) -> vec2f {
    if a.x >= a.y { return b; }
    if b.x >= b.y { return a; }
    return vec2f(min(a.x, b.x), max(a.y, b.y));
}

// The interval of t where |o + t d| < half.
fn slab_chord(o: f32, d: f32, half: f32) -> vec2f {
    if abs(d) < CHORD_STILL { return select(NO_CHORD, WHOLE_LINE, abs(o) < half); }
    let inverse = 1.0 / d;
    let a = (-half - o) * inverse;
    let b = (half - o) * inverse;
    return vec2f(min(a, b), max(a, b));
}

fn cuboid_chord(o: vec3f, d: vec3f, half: vec3f) -> vec2f {
    return both(slab_chord(o.x, d.x, half.x), both(slab_chord(o.y, d.y, half.y), slab_chord(o.z, d.z, half.z)));
}

// The interval of t where normal . p < offset.
fn half_space(o: vec3f, d: vec3f, normal: vec3f, offset: f32) -> vec2f {
    let rate = dot(normal, d);
    let room = offset - dot(normal, o);
    if abs(rate) < CHORD_STILL { return select(NO_CHORD, WHOLE_LINE, room > 0.0); }
    let t = clamp(room / rate, -CHORD_FAR, CHORD_FAR);
    return select(vec2f(t, CHORD_FAR), vec2f(-CHORD_FAR, t), rate > 0.0);
}

// The chord in a ball about zero, in any number of dimensions.
fn round_chord(middle: f32, speed_squared: f32, nearest_squared: f32, radius: f32) -> vec2f {
    let room = radius * radius - nearest_squared;
    if room <= 0.0 { return NO_CHORD; }
    let half = sqrt(room / speed_squared);
    return vec2f(middle - half, middle + half);
}

fn ball_chord(o: vec3f, d: vec3f, radius: f32) -> vec2f {
    let speed_squared = dot(d, d);
    let middle = -dot(o, d) / speed_squared;
    let nearest = o + middle * d;
    return round_chord(middle, speed_squared, dot(nearest, nearest), radius);
}

fn disc_chord(o: vec2f, d: vec2f, radius: f32) -> vec2f {
    let speed_squared = dot(d, d);
    if speed_squared < CHORD_PARALLEL { return select(NO_CHORD, WHOLE_LINE, dot(o, o) < radius * radius); }
    let middle = -dot(o, d) / speed_squared;
    let nearest = o + middle * d;
    return round_chord(middle, speed_squared, dot(nearest, nearest), radius);
}

fn cone_chord(o: vec3f, d: vec3f, low: f32, high: f32, half_height: f32) -> vec2f {
    let ends = slab_chord(o.z, d.z, half_height);
    if ends.x >= ends.y { return NO_CHORD; }
    let middle = 0.5 * (low + high);
    let slope = 0.5 * (high - low) / half_height;
    // The quadratic is solved about the point nearest to the axis, clamped to the two ends.
    let speed_squared = dot(d.xy, d.xy);
    var nearest = 0.0;
    if speed_squared >= CHORD_PARALLEL { nearest = -dot(o.xy, d.xy) / speed_squared; }
    let start = clamp(nearest, ends.x, ends.y);
    let q = o + start * d;
    let radius = middle + slope * q.z;
    let widens = slope * d.z;
    let a = speed_squared - widens * widens;
    let b = dot(q.xy, d.xy) - widens * radius;
    let c = dot(q.xy, q.xy) - radius * radius;
    let discriminant = b * b - a * c;
    if discriminant <= 0.0 { return select(NO_CHORD, ends, a < 0.0); }
    let far = select(-b - sqrt(discriminant), sqrt(discriminant) - b, b < 0.0);
    var first = select(CHORD_FAR, -CHORD_FAR, far < 0.0);
    if a != 0.0 { first = clamp(far / a, -CHORD_FAR, CHORD_FAR); }
    var second = 0.0;
    if far != 0.0 { second = c / far; }
    let early = start + min(first, second);
    let late = start + max(first, second);
    if a > 0.0 { return both(ends, vec2f(early, late)); }
    // The roots bound one of the two halves of the double cone. The other half lies beyond the ends.
    let before = vec2f(ends.x, min(ends.y, early));
    let after = vec2f(max(ends.x, late), ends.y);
    return select(after, before, before.y - before.x > after.y - after.x);
}

fn pyramid_chord(o: vec3f, d: vec3f, k: array<f32, 6>, grow: f32) -> vec2f {
    let offset = k[0] * k[4] - k[1] * k[3] + grow;
    var chord = half_space(o, d, vec3f(0.0, 0.0, -1.0), k[1] + grow);
    chord = both(chord, half_space(o, d, vec3f(k[4], 0.0, k[3]), offset));
    chord = both(chord, half_space(o, d, vec3f(-k[4], 0.0, k[3]), offset));
    chord = both(chord, half_space(o, d, vec3f(0.0, k[4], k[3]), offset));
    return both(chord, half_space(o, d, vec3f(0.0, -k[4], k[3]), offset));
}

fn slanted_slab(o: vec3f, d: vec3f, normal: vec3f, half: f32) -> vec2f {
    return slab_chord(dot(normal, o), dot(normal, d), half);
}

// The chord of a line in a leaf whose surface is moved outwards by `grow`. It has the same kinds as leaf_distance.
fn leaf_chord(leaf: u32, origin: vec3f, direction: vec3f, grow: f32) -> vec2f {
    let o = placed(leaf, origin);
    let d = vec3f(
        dot(leaves[leaf].row_x, direction),
        dot(leaves[leaf].row_y, direction),
        dot(leaves[leaf].row_z, direction),
    );
    let a = leaves[leaf].a;
    let b = leaves[leaf].b;
    // Half sizes, moved outwards by `grow`.
    let s = max(a.xyz + grow, vec3f(0.0));
    let first = leaves[leaf].first;
    switch leaves[leaf].kind {
        case KIND_SPHERE: { return ball_chord(o, d, s.x); }
        case KIND_ELLIPSOID: { return ball_chord(o / (a.xyz + grow), d / (a.xyz + grow), 1.0); }
        case KIND_ROUNDED_BOX: { return cuboid_chord(o, d, s); }
        case KIND_CYLINDER: { return both(disc_chord(o.xy, d.xy, s.x), slab_chord(o.z, d.z, s.y)); }
        case KIND_CAPSULE: {
            let end = vec3f(0.0, 0.0, a.y);
            let side = both(disc_chord(o.xy, d.xy, s.x), slab_chord(o.z, d.z, a.y));
            return hull(hull(side, ball_chord(o - end, d, s.x)), ball_chord(o + end, d, s.x));
        }
        case KIND_CONE: { return cone_chord(o, d, s.x, s.y, s.z); }
        case KIND_PLANE: { return half_space(o, d, a.xyz, a.w + grow); }
        case KIND_PYRAMID: { return pyramid_chord(o, d, array<f32, 6>(a.x, a.y, a.z, a.w, b.x, b.y), grow); }
        case KIND_OCTAHEDRON: {
            // The normals of the faces have length sqrt(3).
            let half = max(a.x + 1.7320508 * grow, 0.0);
            let one = both(slanted_slab(o, d, vec3f(1.0), half), slanted_slab(o, d, vec3f(1.0, 1.0, -1.0), half));
            let other =
                both(slanted_slab(o, d, vec3f(1.0, -1.0, 1.0), half), slanted_slab(o, d, vec3f(-1.0, 1.0, 1.0), half));
            return both(one, other);
        }
        case KIND_HEX_PRISM: {
            let sides = both(
                slanted_slab(o, d, vec3f(0.8660254, 0.5, 0.0), s.x),
                slanted_slab(o, d, vec3f(0.8660254, -0.5, 0.0), s.x),
            );
            return both(both(slab_chord(o.z, d.z, s.y), slab_chord(o.y, d.y, s.x)), sides);
        }
        case KIND_EXTRUDED_CIRCLE: {
            return both(disc_chord(o.xy, d.xy, max(numbers[first] + grow, 0.0)), slab_chord(o.z, d.z, s.x));
        }
        case KIND_EXTRUDED_RECTANGLE: {
            return cuboid_chord(o, d, vec3f(max(corner_at(first) + grow, vec2f(0.0)), s.x));
        }
        default: { return NO_CHORD; }
    }
}

// Whether a line is inside immediately behind t. `chords` has one entry per literal, in the order of the tokens.
fn is_inside(chords: ptr<function, array<vec2f, CHORD_LEAVES>>, first: u32, count: u32, t: f32) -> bool {
    // A stack of bits; the top is bit 0.
    var bits = 0u;
    var next = 0;
    for (var i = 0u; i < count && has_rounds(); i++) {
        rounds++;
        let token = tokens[first + i];
        let what = token >> TOKEN_SHIFT;
        if what == TOKEN_LEAF {
            let chord = (*chords)[next];
            let is_complement = (token & TOKEN_COMPLEMENTED) != 0u;
            bits = (bits << 1u) | select(0u, 1u, (chord.x <= t && t < chord.y) != is_complement);
            next++;
        } else if what == TOKEN_UNION {
            bits = (bits >> 1u) | (bits & 1u);
        } else {
            bits = (bits >> 1u) & (bits | 0xfffffffeu);
        }
    }
    return (bits & 1u) == 1u;
}

// The first point on [t_in, t_out) where a line is inside a part in closed form, or -1.
fn first_inside(
    origin: vec3f,
    direction: vec3f,
    first: u32,
    count: u32,
    is_union: bool,
    t_in: f32,
    t_out: f32,
) -> f32 {
    var chords: array<vec2f, CHORD_LEAVES>;
    var leaf_count = 0u;
    var nearest = t_out;
    // The end of a chord that is the hit belongs to this token.
    var owner = 0u;
    var is_start = true;
    // One call of leaf_chord evaluates all literals and, in the last turn, the uneroded chord of the owner.
    for (var i = 0u; i <= count && has_rounds(); i++) {
        rounds++;
        let is_last = i == count;
        if is_last {
            if is_union || !COMBINES_CHORDS { return select(-1.0, nearest, nearest < t_out); }
            nearest = first_end(&chords, leaf_count, first, count, t_in, t_out);
            if nearest < t_in || nearest == t_in { return nearest; }
            var literal = 0u;
            for (var j = 0u; j < count && has_rounds(); j++) {
                rounds++;
                let token = tokens[first + j];
                if token >> TOKEN_SHIFT != TOKEN_LEAF { continue; }
                let chord = chords[literal];
                if chord.x == nearest || chord.y == nearest {
                    owner = token;
                    is_start = chord.x == nearest;
                    break;
                }
                literal++;
            }
        }
        let token = select(tokens[first + min(i, count - 1u)], owner, is_last);
        if token >> TOKEN_SHIFT != TOKEN_LEAF { continue; }
        let grow = select(-ERODED, ERODED, (token & TOKEN_COMPLEMENTED) != 0u);
        let chord = leaf_chord(token & TOKEN_INDEX, origin, direction, select(grow, 0.0, is_union || is_last));
        if is_last { return clamp(select(chord.y, chord.x, is_start), t_in, nearest); }
        if max(chord.x, t_in) < chord.y { nearest = min(nearest, max(chord.x, t_in)); }
        if COMBINES_CHORDS { chords[leaf_count] = chord; }
        leaf_count++;
    }
    return -1.0;
}

// The first t among t_in and the ends of the chords on [t_in, t_out) behind which a line is inside, or -1.
fn first_end(
    chords: ptr<function, array<vec2f, CHORD_LEAVES>>,
    leaf_count: u32,
    first: u32,
    count: u32,
    t_in: f32,
    t_out: f32,
) -> f32 {
    var t = t_in;
    // Each round advances to the next end of a chord.
    for (var i = 0u; i <= 2u * CHORD_LEAVES && has_rounds(); i++) {
        rounds++;
        if is_inside(chords, first, count, t) { return t; }
        var next = t_out;
        for (var j = 0u; j < leaf_count && has_rounds(); j++) {
            rounds++;
            let chord = (*chords)[j];
            if chord.x >= chord.y { continue; }
            if chord.x > t { next = min(next, chord.x); }
            if chord.y > t { next = min(next, chord.y); }
        }
        if next >= t_out { return -1.0; }
        t = next;
    }
    return -1.0;
}

// Step of the tetrahedral differences of a leaf along each axis, in the space of the leaf, where coordinates near its
// surface are small.
const LEAF_STEP: f32 = 4e-5;

// Corner of a tetrahedron about zero, of length sqrt(3).
fn tetrahedron(i: u32) -> vec3f {
    return vec3f(
        select(-1.0, 1.0, i == 0u || i == 3u),
        select(-1.0, 1.0, i == 2u || i == 3u),
        select(-1.0, 1.0, i == 1u || i == 3u),
    );
}

// The normal, of any length, where a line enters a part in closed form: the gradient of the leaf with the nearest
// surface, turned against the line. The first `count` turns find the leaf. The last four evaluate its gradient.
fn chord_slope(p: vec3f, direction: vec3f, first: u32, count: u32) -> vec3f {
    var nearest = CSG_FAR;
    var leaf = 0u;
    var own = vec3f(0.0);
    for (var i = 0u; i < count + 4u && has_rounds(); i++) {
        rounds++;
        let is_search = i < count;
        let token = select(leaf, tokens[first + min(i, count - 1u)], is_search);
        if token >> TOKEN_SHIFT != TOKEN_LEAF { continue; }
        let candidate = token & TOKEN_INDEX;
        let corner = select(tetrahedron(i - count), vec3f(0.0), is_search);
        let distance = own_distance(candidate, placed(candidate, p) + LEAF_STEP * corner);
        own += distance * corner;
        if is_search && abs(distance) < nearest {
            nearest = abs(distance);
            leaf = candidate;
        }
    }
    let slope = own.x * leaves[leaf].row_x + own.y * leaves[leaf].row_y + own.z * leaves[leaf].row_z;
    return select(slope, -slope, dot(slope, direction) > 0.0);
}
