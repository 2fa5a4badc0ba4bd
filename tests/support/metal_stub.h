// Declarations with which a C++ parser reads Metal shading language: types and functions of the standard library that the
// texts of fieldbake use, without bodies. Enough to find wrong syntax, names, types and counts of arguments.
#define kernel
#define device
#define constant const
#define thread
#define fragment
#define vertex
typedef decltype(sizeof(0)) size_t;

namespace metal {
typedef unsigned int uint;
typedef unsigned short ushort;

template <typename T> struct vec2 {
    T x, y;
    vec2 &xy, &yx, &xx, &yy;
    vec2();
    vec2(const vec2&);
    vec2& operator=(const vec2&);
    vec2(T);
    vec2(T, T);
    template <typename U> explicit vec2(vec2<U>);
    T& operator[](uint);
    T operator[](uint) const;
};
template <typename T> struct vec3 {
    T x, y, z;
    // References, for a type cannot hold itself.
    vec2<T>&xy, &xz, &yz, &yx, &zx, &zy;
    vec3 &xyz, &yzx, &zxy, &zyx, &xxx, &yyy, &zzz;
    vec3();
    vec3(const vec3&);
    vec3& operator=(const vec3&);
    vec3(T);
    vec3(T, T, T);
    vec3(vec2<T>, T);
    vec3(T, vec2<T>);
    template <typename U> explicit vec3(vec3<U>);
    T& operator[](uint);
    T operator[](uint) const;
};
template <typename T> struct vec4 {
    T x, y, z, w;
    vec2<T>&xy, &zw;
    vec3<T>& xyz;
    vec4();
    vec4(const vec4&);
    vec4& operator=(const vec4&);
    vec4(T);
    vec4(T, T, T, T);
    vec4(vec3<T>, T);
    template <typename U> explicit vec4(vec4<U>);
    T& operator[](uint);
    T operator[](uint) const;
};
typedef vec2<float> float2; typedef vec3<float> float3; typedef vec4<float> float4;
typedef vec2<int> int2; typedef vec3<int> int3; typedef vec4<int> int4;
typedef vec2<uint> uint2; typedef vec3<uint> uint3; typedef vec4<uint> uint4;
typedef vec2<bool> bool2; typedef vec3<bool> bool3; typedef vec4<bool> bool4;
typedef vec3<float> packed_float3; typedef vec3<uint> packed_uint3;
struct float4x4 { float4 columns[4]; float4& operator[](uint); };

#define OPERATORS(V) \
    template <typename T> V<T> operator+(V<T>, V<T>); template <typename T> V<T> operator-(V<T>, V<T>); \
    template <typename T> V<T> operator*(V<T>, V<T>); template <typename T> V<T> operator/(V<T>, V<T>); \
    template <typename T> V<T> operator%(V<T>, V<T>); template <typename T> V<T> operator&(V<T>, T); \
    template <typename T> V<T> operator&(V<T>, V<T>); \
    template <typename T> V<T> operator|(V<T>, V<T>); template <typename T> V<bool> operator==(V<T>, T); template <typename T> V<T> operator-(V<T>); \
    template <typename T> V<T> operator*(V<T>, T); template <typename T> V<T> operator*(T, V<T>); \
    template <typename T> V<T> operator/(V<T>, T); template <typename T> V<T> operator+(V<T>, T); \
    template <typename T> V<T> operator-(V<T>, T); template <typename T> V<T> operator+(T, V<T>); \
    template <typename T> V<T> operator-(T, V<T>); template <typename T> V<T> operator/(T, V<T>); \
    template <typename T> V<bool> operator<(V<T>, V<T>); template <typename T> V<bool> operator<=(V<T>, V<T>); \
    template <typename T> V<bool> operator>(V<T>, V<T>); template <typename T> V<bool> operator>=(V<T>, V<T>); \
    template <typename T> V<bool> operator==(V<T>, V<T>); template <typename T> V<bool> operator!=(V<T>, V<T>); \
    template <typename T> V<T> abs(V<T>); template <typename T> V<T> floor(V<T>); template <typename T> V<T> sign(V<T>); \
    template <typename T> V<T> sqrt(V<T>); template <typename T> V<T> round(V<T>); template <typename T> V<T> fract(V<T>); \
    template <typename T> V<T>& operator+=(V<T>&, V<T>); template <typename T> V<T>& operator-=(V<T>&, V<T>); \
    template <typename T> V<T> max(V<T>, T); template <typename T> V<T> min(V<T>, T); \
    template <typename T> V<T> min(V<T>, V<T>); template <typename T> V<T> max(V<T>, V<T>); \
    template <typename T> V<T> clamp(V<T>, T, T); template <typename T> V<T> clamp(V<T>, V<T>, V<T>); template <typename T> V<T> mix(V<T>, V<T>, V<T>); \
    template <typename T> V<T> mix(V<T>, V<T>, T); template <typename T> V<T> select(V<T>, V<T>, V<bool>); \
    template <typename T> V<T> select(V<T>, T, V<bool>); \
    template <typename T> V<T> normalize(V<T>); template <typename T> T dot(V<T>, V<T>); template <typename T> T length(V<T>); \
    template <typename T> T distance(V<T>, V<T>); bool any(V<bool>); bool all(V<bool>); \
    template <typename T> V<T> sin(V<T>); template <typename T> V<T> cos(V<T>); template <typename T> V<T> exp(V<T>); \
    template <typename T> V<T> fma(V<T>, V<T>, V<T>);
OPERATORS(vec2)
OPERATORS(vec3)
OPERATORS(vec4)

#define ONE(name) float name(float);
ONE(abs) ONE(floor) ONE(ceil) ONE(round) ONE(rint) ONE(trunc) ONE(fract) ONE(sqrt) ONE(rsqrt) ONE(sin) ONE(cos) ONE(tan)
ONE(asin) ONE(acos) ONE(atan) ONE(exp) ONE(exp2) ONE(log) ONE(log2) ONE(sign) ONE(saturate)
int abs(int);
float min(float, float); float max(float, float); float clamp(float, float, float);
int min(int, int); int max(int, int); int clamp(int, int, int);
uint min(uint, uint); uint max(uint, uint); uint clamp(uint, uint, uint);
float mix(float, float, float); float pow(float, float); float atan2(float, float); float fmod(float, float);
float fma(float, float, float); float step(float, float); float smoothstep(float, float, float);
template <typename T> T select(T, T, bool);
bool isinf(float); bool isnan(float);

enum class access { sample, read, write };
struct level { explicit level(float); };
enum class coord { normalized, pixel };
struct sampler {};
template <typename T, access A = access::sample> struct texture2d_array {
    vec4<T> sample(sampler, float2, uint, level) const;
    vec4<T> sample(sampler, float2, int, level) const;
    vec4<T> read(uint2, uint, uint = 0) const;
    uint get_width(uint = 0) const; uint get_height(uint = 0) const; uint get_array_size() const;
};
template <typename T, access A = access::sample> struct texture2d {
    vec4<T> sample(sampler, float2, level) const;
    vec4<T> read(uint2, uint = 0) const;
    uint get_width(uint = 0) const; uint get_height(uint = 0) const;
};
template <typename T, access A = access::sample> struct texture3d {
    vec4<T> sample(sampler, float3, level) const;
    vec4<T> read(uint3, uint = 0) const;
    uint get_width(uint = 0) const; uint get_height(uint = 0) const; uint get_depth(uint = 0) const;
};
}  // namespace metal

using metal::uint2;  // simd/simd.h declares it.
template <typename T, typename U> T as_type(U);
