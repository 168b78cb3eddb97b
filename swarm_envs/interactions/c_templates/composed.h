static const struct @name@_network @name@_pair[@NAME@_TYPES][@NAME@_TYPES] = {
    @pair@}; /* [neighbor][drone] */
static const struct @name@_network @name@_own[@NAME@_TYPES] = {
    @own@};

/* What the air does to a drone alone: nothing at the anchor height and above. N. */
static inline float @name@_alone(int own_type, float height, const float velocity[3])
{
    float values[2][@widest@];
    const float speed = sqrtf(velocity[0] * velocity[0] + velocity[1] * velocity[1]);
    const float(*range)[4] = @name@_environment_range;
    values[0][0] = @name@_clamp(-height, range[0][0], range[1][0]) / @own_units@[0];
    values[0][1] = (speed < range[1][1] ? speed : range[1][1]) / @own_units@[1];
    values[0][2] = @name@_clamp(-velocity[2], range[0][3], range[1][3]) / @own_units@[2];
    return @name@_apply(&@name@_own[own_type], values)[0] * @gram@;
}

/* What one neighbor does: its push (N), times the way towards the axis of its wake, and down. */
static inline void @name@_push(int own_type, int type, const float velocity[3],
                               const float relative[6], float weight, float push[3])
{
    const float(*range)[6] = @name@_pair_range, *wake = @name@_wake[type * @NAME@_TYPES + own_type];
    const float depth = relative[2] > 0.0f ? relative[2] : 0.0f, late = depth * @name@_delay[type];
    const float x = relative[0] - (relative[3] + velocity[0]) * late;
    const float y = relative[1] - (relative[4] + velocity[1]) * late;
    const float u = relative[3], v = relative[4], square = x * x + y * y;
    const float way = 1.0f / sqrtf(square + @axis@ * @axis@), radial = (x * u + y * v) * way;
    const float rest = u * u + v * v - radial * radial;
    const float farthest = sqrtf(range[1][0] * range[1][0] + range[1][1] * range[1][1]);
    const float r = sqrtf(square) < farthest ? sqrtf(square) : farthest;
    const float across = rest > 0.0f ? sqrtf(rest) : 0.0f;
    const float dz = @name@_clamp(relative[2], range[0][2], range[1][2]);
    const float width = wake[1] + wake[2] * (dz > 0.0f ? dz : 0.0f), aside = r / width;
    float values[2][@widest@], lean;
    const float *result;
    values[0][0] = r / @pair_units@[0];
    values[0][1] = dz / @pair_units@[1];
    values[0][2] = @name@_clamp(radial, range[0][3], range[1][3]) / @pair_units@[2];
    values[0][3] = (across < range[1][3] ? across : range[1][3]) / @pair_units@[3];
    values[0][4] = @name@_clamp(relative[5], range[0][5], range[1][5]) / @pair_units@[4];
    result = @name@_apply(&@name@_pair[type][own_type], values);
    push[2] = wake[0] * powf(wake[1] / width, wake[3]) * expf(-0.5f * aside * aside) /
                  (1.0f + expf(-dz / @onset@)) +
              result[0] * @gram@;
    push[2] = push[2] < 0.0f ? 0.0f : push[2] * weight;
    lean = push[2] * @name@_clamp(result[1], -1.0f, 1.0f) * way;
    push[0] = lean * x;
    push[1] = lean * y;
}

/* Force, N: interaction and drag. Types are those of the enumeration above. */
static inline void @name@_force(int own_type, const float position[3], const float velocity[3],
                                int neighbors, const int *types, const float *relative,
                                float force[3])
{
    const float anchor = @anchor@; /* m; a lone drone feels nothing from there up; 0 if unused */
    const float height = position[2] > @lowest@ ? position[2] : @lowest@;
    float powers = 0.0f, pairs[3] = {0.0f, 0.0f, 0.0f}, joined;
    int j, k;
    for (k = 0; k < 3; k++) force[k] = -@name@_drag[own_type][k] * velocity[k];
    if (anchor <= 0.0f || position[2] < anchor) {
        force[2] += @name@_alone(own_type, position[2], velocity);
        if (anchor > 0.0f) force[2] -= @name@_alone(own_type, anchor, velocity);
    }
    for (j = 0; j < neighbors; j++, relative += 6) {
        const float *f = @name@_window;
        const float beside = sqrtf(relative[0] * relative[0] + relative[1] * relative[1]);
        const float weight = @name@_fade(beside, f[0], f[1], f[2]) *
                             @name@_fade(relative[2], f[3], f[4], f[5]);
        float push[3];
        if (weight <= 0.0f) continue;
        @name@_push(own_type, types[j], velocity, relative, weight, push);
        powers += powf(push[2], @q@);
        for (k = 0; k < 3; k++) pairs[k] += push[k];
    }
    if (pairs[2] <= 0.0f) return;
    joined = (1.0f - @lost@ * expf(-height / @fading@)) * powf(powers, 1.0f / @q@);
    force[0] += pairs[0] * joined / pairs[2];
    force[1] += pairs[1] * joined / pairs[2];
    force[2] -= joined;
}

/* The vertical component of it, N. */
static inline float @name@_force_z(int own_type, const float position[3], const float velocity[3],
                                   int neighbors, const int *types, const float *relative)
{
    float force[3];
    @name@_force(own_type, position, velocity, neighbors, types, relative, force);
    return force[2];
}

