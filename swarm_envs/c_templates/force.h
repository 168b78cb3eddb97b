/* Vertical interaction force on a drone, made by `swarm-envs export force`. C99, float only.
 *
@provenance@
 *
 * Call it with the drone's own type, its position (m, world frame, z up from the ground) and
 * velocity (m/s), and for each neighbour its type, offset (its position minus the drone's) and
 * relative velocity (its velocity minus the drone's): six numbers a neighbour, one after the
 * other. Neighbours beyond @lateral@ m in x or y or @vertical@ m in z cost nothing. Forces are in
 * newton, world frame, and include drag. Inputs beyond the measured range are clamped to it.
 *
@costs@
 *
 * With @NAME@_SELF_TEST defined, @name@_self_test() gives the largest difference, in
 * gram-force, from the float64 model over @samples@ states; it should be below 0.001.
 */
#ifndef @NAME@_FORCE_H
#define @NAME@_FORCE_H

enum {
@types@
};

@tables@

struct @name@_network {
    const float *weights; /* per output: its bias, then its row of the matrix */
    const int *widths;
    int layers;
};

static const struct @name@_network @name@_phi[@NAME@_TYPES] = {
    @phi@};
static const struct @name@_network @name@_phi_environment = @environment@;
static const struct @name@_network @name@_rho[@NAME@_TYPES] = {
    @rho@};

static inline float @name@_clamp(float value, float low, float high)
{
    return value < low ? low : (value > high ? high : value);
}

/* Weight from 1 (at `full` and below) to 0 (at `end`): a quintic smoothstep. */
static inline float @name@_fade(float distance, float full, float end, float steepness)
{
    float u;
    if (distance < 0.0f) distance = -distance;
    if (distance >= end) return 0.0f;
    if (distance <= full) return 1.0f;
    u = (distance - full) * steepness;
    return 1.0f - u * u * u * (10.0f + u * (6.0f * u - 15.0f));
}

/* Apply a ReLU network to values[0]; what is returned lies in one of the two rows. */
static inline const float *@name@_apply(const struct @name@_network *net,
                                        float values[2][@widest@])
{
    const float *w = net->weights;
    int from = 0, layer, o, i;
    for (layer = 0; layer < net->layers; layer++, from = 1 - from) {
        const int inputs = net->widths[layer], outputs = net->widths[layer + 1];
        const float *x = values[from];
        for (o = 0; o < outputs; o++) {
            float sum = *w++;
            for (i = 0; i < inputs; i++) sum += w[i] * x[i];
            w += inputs;
            values[1 - from][o] = sum < 0.0f && layer < net->layers - 1 ? 0.0f : sum;
        }
    }
    return values[from];
}

static inline void @name@_environment(float height, const float velocity[3], float code[@hidden@])
{
    float values[2][@widest@];
    const float *result;
    int k;
    values[0][0] = -height;
    for (k = 0; k < 3; k++) values[0][k + 1] = -velocity[k];
    for (k = 0; k < 4; k++)
        values[0][k] = @name@_clamp(values[0][k], @name@_environment_range[0][k],
                                    @name@_environment_range[1][k]);
    result = @name@_apply(&@name@_phi_environment, values);
    for (k = 0; k < @hidden@; k++) code[k] += result[k];
}

static inline float @name@_output(int own_type, const float code[@hidden@])
{
    float values[2][@widest@];
    int k;
    for (k = 0; k < @hidden@; k++) values[0][k] = code[k];
    return @name@_apply(&@name@_rho[own_type], values)[0] * @gram@;
}

/* Add the codes of the neighbours in the volume; whether there are any. */
static inline int @name@_neighbours(int neighbours, const int *types, const float *relative,
                                    float code[@hidden@])
{
    float values[2][@widest@];
    int any = 0, j, k;
    for (j = 0; j < neighbours; j++, relative += 6) {
        const float *f = @name@_window;
        const float weight = @name@_fade(relative[0], f[0], f[1], f[2]) *
                             @name@_fade(relative[1], f[0], f[1], f[2]) *
                             @name@_fade(relative[2], f[3], f[4], f[5]);
        const float *result;
        if (weight <= 0.0f) continue;
        for (k = 0; k < 6; k++)
            values[0][k] = @name@_clamp(relative[k], @name@_pair_range[0][k],
                                        @name@_pair_range[1][k]);
        result = @name@_apply(&@name@_phi[types[j]], values);
        for (k = 0; k < @hidden@; k++) code[k] += weight * result[k];
        any = 1;
    }
    return any;
}

/* Vertical force, N: interaction and drag. Types are those of the enumeration above. */
static inline float @name@_force_z(int own_type, const float position[3], const float velocity[3],
                                   int neighbours, const int *types, const float *relative)
{
    const float anchor = @anchor@; /* m; a lone drone feels nothing from there up; 0 if unused */
    float code[@hidden@] = {0.0f}, alone[@hidden@] = {0.0f};
    float force = -@name@_drag[own_type][2] * velocity[2];
    const int low = anchor <= 0.0f || position[2] < anchor;
    if (!@name@_neighbours(neighbours, types, relative, code) && !low) return force;
    @name@_environment(low ? position[2] : anchor, velocity, code);
    force += @name@_output(own_type, code);
    if (anchor > 0.0f) {
        @name@_environment(anchor, velocity, alone);
        force -= @name@_output(own_type, alone);
    }
    return force;
}

/* All three components, N: drag alone acts in x and y. */
static inline void @name@_force(int own_type, const float position[3], const float velocity[3],
                                int neighbours, const int *types, const float *relative,
                                float force[3])
{
    force[0] = -@name@_drag[own_type][0] * velocity[0];
    force[1] = -@name@_drag[own_type][1] * velocity[1];
    force[2] = @name@_force_z(own_type, position, velocity, neighbours, types, relative);
}

#ifdef @NAME@_SELF_TEST
/* Largest difference from the float64 model, gram-force. */
static inline float @name@_self_test(void)
{
    /* own type, the neighbours' types */
    static const int kinds[@samples@][1 + @neighbours@] = {
@test_types@};
    /* height, own velocity, the neighbours' offsets and relative velocities, vertical force (N) */
    static const float states[@samples@][5 + 6 * @neighbours@] = {
@test_states@};
    float worst = 0.0f;
    int k;
    for (k = 0; k < @samples@; k++) {
        const float *s = states[k];
        const float position[3] = {0.0f, 0.0f, s[0]};
        const float z = @name@_force_z(kinds[k][0], position, s + 1, @neighbours@, kinds[k] + 1,
                                       s + 4);
        float error = (z - s[4 + 6 * @neighbours@]) / @gram@;
        if (error < 0.0f) error = -error;
        if (error > worst) worst = error;
    }
    return worst;
}
#endif

#endif
