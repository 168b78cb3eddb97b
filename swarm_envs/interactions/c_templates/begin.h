/* Interaction force on a drone, made by swarm_envs.interactions.c_header. C99, float only.
 *
@provenance@
 *
 * Call it with the drone's own type, its position (m, world frame, z up from the ground) and
 * velocity (m/s), and for each neighbor its type, offset (its position minus the drone's) and
 * relative velocity (its velocity minus the drone's): six numbers a neighbor, one after the
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

@include@enum {
@types@
};

@tables@

struct @name@_network {
    const float *weights; /* per output: its bias, then its row of the matrix */
    const int *widths;
    int layers;
};

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

