"""GLSL shaders of the window: the light of `shading`, computed on the graphics card."""

from __future__ import annotations

VERTEX = """
#version 330 core
in vec3 place;
in vec3 normal;
in vec3 color;
in vec3 mark;
uniform mat4 to_clip;
out vec3 at;
out vec3 out_of;
out vec3 tint;
out vec3 body;

void main() {
    at = place;
    out_of = normal;
    tint = color;
    body = mark;
    gl_Position = to_clip * vec4(place, 1.0);
}
"""

FRAGMENT = """
#version 330 core
in vec3 at;
in vec3 out_of;
in vec3 tint;
in vec3 body;
out vec4 shown;

uniform int kind;  // 0: a surface, 1: the ground, 2: the background
uniform vec3 eye;
uniform vec3 key_direction;
uniform vec3 fill_direction;
uniform vec3 strengths;  // key, fill, ambient
uniform vec3 wrap;
uniform vec3 gloss;  // specular, exponent, rim
uniform vec3 finish;  // metallic, grain, mottle
uniform float opacity;
uniform float ground_height;
uniform vec4 ground_grid;  // centre x and y, tile, line width
uniform vec2 ground_fade;
uniform vec3 ground_color;
uniform vec3 line_color;
uniform vec3 top_color;
uniform vec3 bottom_color;
uniform vec2 picture;
uniform vec2 darkness;  // of shadows on surfaces and on the ground
uniform mat4 to_light;
uniform float light_texel;
uniform sampler2D blockers;

const vec3 SKY = vec3(0.98, 1.0, 1.04);
const vec3 BOUNCE = vec3(0.52, 0.47, 0.45);
const vec3 KEY_COLOR = vec3(1.0, 0.975, 0.94);
const vec3 FILL_COLOR = vec3(0.86, 0.94, 1.0);

vec3 to_linear(vec3 c) {
    return mix(c / 12.92, pow((c + 0.055) / 1.055, vec3(2.4)), step(vec3(0.04045), c));
}

vec3 to_display(vec3 c) {
    c = clamp(c, 0.0, 1.0);
    return mix(c * 12.92, 1.055 * pow(c, vec3(1.0 / 2.4)) - 0.055, step(vec3(0.0031308), c));
}

float lattice(ivec3 p) {
    uint code = uint(p.x) * 73856093u ^ uint(p.y) * 19349663u ^ uint(p.z) * 83492791u;
    code = (code ^ (code >> 13)) * 1274126177u;
    return float((code >> 16) & 0xFFFFu) * (2.0 / 65535.0) - 1.0;
}

float noise(vec3 p) {
    ivec3 i = ivec3(floor(p));
    vec3 f = p - vec3(i);
    f = f * f * (3.0 - 2.0 * f);
    vec4 near = vec4(lattice(i), lattice(i + ivec3(1, 0, 0)), lattice(i + ivec3(0, 1, 0)),
                     lattice(i + ivec3(1, 1, 0)));
    vec4 far = vec4(lattice(i + ivec3(0, 0, 1)), lattice(i + ivec3(1, 0, 1)), lattice(i + ivec3(0, 1, 1)),
                    lattice(i + ivec3(1, 1, 1)));
    vec4 z = mix(near, far, f.z);
    vec2 y = mix(z.xy, z.zw, f.y);
    return mix(y.x, y.y, f.x);
}

// How much of the key light arrives, blurred over a square of three times so many texels.
float lit(vec3 p, float reach) {
    vec3 place = (to_light * vec4(p, 1.0)).xyz * 0.5 + 0.5;
    if (any(lessThan(place, vec3(0.0))) || any(greaterThan(place, vec3(1.0)))) return 1.0;
    // Weights that fall linearly between texels, so that borders are smooth.
    float apart = reach * light_texel;
    vec2 corner = place.xy / apart - 0.5;
    vec2 part = fract(corner);
    float sum = 0.0;
    for (int i = -1; i <= 2; ++i)
        for (int j = -1; j <= 2; ++j) {
            vec2 to = (floor(corner) + 0.5 + vec2(i, j)) * apart;
            vec2 weight = vec2(i == -1 ? 1.0 - part.x : (i == 2 ? part.x : 1.0),
                               j == -1 ? 1.0 - part.y : (j == 2 ? part.y : 1.0));
            sum += weight.x * weight.y * step(place.z, texture(blockers, to).r);
        }
    return sum / 9.0;
}

vec3 backdrop() {
    return to_linear(mix(bottom_color, top_color, gl_FragCoord.y / picture.y));
}

vec3 ground() {
    vec2 p = at.xy - ground_grid.xy;
    vec2 wide = max(fwidth(p), vec2(1e-5));
    vec2 away = abs(fract(p / ground_grid.z + 0.5) - 0.5) * ground_grid.z;
    vec2 line = clamp((0.5 * ground_grid.w + 0.5 * wide - away) / wide, 0.0, 1.0) * min(ground_grid.w / wide, 1.0);
    vec3 base = mix(to_linear(ground_color), to_linear(line_color), 1.0 - (1.0 - line.x) * (1.0 - line.y));
    base *= 1.0 - 0.6 * darkness.y * (1.0 - lit(at, 6.0));
    return mix(base, backdrop(), smoothstep(ground_fade.x, ground_fade.y, length(p)));
}

vec3 surface() {
    vec3 base = to_linear(tint);
    vec3 n = normalize(out_of);
    vec3 v = normalize(eye - at);
    if (dot(n, v) < 0.0 && !gl_FrontFacing) n = -n;
    if (finish.z > 0.0) {
        float broad = noise(0.55 * body + vec3(7.3, 1.7, 4.1));
        float fine = noise(2.1 * body + vec3(0.5 * broad, 9.2, 0.0));
        float width = 0.03 + 0.5 * length(fwidth(body));
        float vessel = max(1.0 - abs(broad + 0.16 * fine) / width, 0.0) * min(0.04 / width, 1.0);
        vessel *= clamp(2.5 * noise(0.9 * body + vec3(3.9, 5.3, 8.8)) + 0.1, 0.0, 1.0) * finish.z;
        float patches = (0.6 * broad + 0.4 * fine) * finish.z;
        base *= (1.0 + vec3(0.22, 0.45, 0.40) * patches) * (1.0 - vec3(0.30, 0.68, 0.58) * vessel);
    }
    float streak = 0.0;
    if (finish.y > 0.0) {
        // Finer marks than the picture's pixels would flicker.
        float along = body.y + body.z;
        float seen = max(1.0 - 60.0 * fwidth(along), 0.0);
        streak = 0.6 * noise(vec3(14.0 * along, 0.5, 0.5)) + 0.4 * noise(vec3(43.0 * along, 0.5, 0.5));
        streak *= finish.y * seen;
    }
    float n_l = dot(n, key_direction);
    float n_v = dot(n, v);
    float fresnel = pow(1.0 - clamp(n_v, 0.0, 1.0), 5.0);
    // Looked up a little off the surface: a coarse surface would shadow itself in stripes.
    float light = n_l < -0.2 ? 1.0 : 1.0 - darkness.x * (1.0 - lit(at + 0.12 * n, 1.5));
    float ambient = strengths.z;
    float up = 0.5 + 0.5 * n.z;
    float high = 1.0 + max(at.z - ground_height, 0.0) * 0.833;
    ambient *= 1.0 - 0.65 * (1.0 - up) / (high * high);
    vec3 key = strengths.x * light * max(n_l + wrap, 0.0) / (1.0 + wrap);
    float fill = 0.5 + 0.5 * dot(n, fill_direction);
    vec3 room = ambient * mix(BOUNCE, SKY, up);
    float shine = 0.0;
    if (gloss.x > 0.0 && n_l > 0.0) {
        float half_way = max(dot(n, normalize(key_direction + v)), 0.0);
        shine = pow(half_way, gloss.y) + 0.1 * pow(half_way, gloss.y / 16.0);
        shine *= gloss.x * strengths.x * light * (0.6 + 0.4 * fresnel) * min(4.0 * n_l, 1.0);
    }
    if (finish.x > 0.0) {
        vec3 mirrored = reflect(-v, n);
        float height = mirrored.z + 0.35 * streak;
        float around = height < 0.0 ? 0.34 - 0.34 * max(height, -1.0) : 0.34 + 0.62 * min(height, 1.0);
        float box = clamp((dot(mirrored, key_direction) + 0.25 * streak - 0.55) * 2.5, 0.0, 1.0);
        around += 0.75 * light * box * box * (3.0 - 2.0 * box);
        around *= 2.0 * ambient * (1.0 + 0.35 * streak);
        key *= 1.0 - 0.75 * finish.x;
        room = mix(room, vec3(around), finish.x);
    }
    float edge = gloss.z * fresnel * ambient * (0.7 + 1.3 * up);
    return base * (KEY_COLOR * key + FILL_COLOR * strengths.y * fill * fill + room) + KEY_COLOR * shine + edge;
}

void main() {
    vec3 light = kind == 0 ? surface() : (kind == 1 ? ground() : backdrop());
    shown = vec4(to_display(light), opacity);
}
"""

SHADOW_FRAGMENT = """
#version 330 core
in vec3 at;
in vec3 out_of;
in vec3 tint;
in vec3 body;

void main() {
}
"""
