/* A trained policy, made by `swarm-envs export policy`. C99, float only, needs math.h alone.
 *
@provenance@
 *
 * Frames and units: world frame, z up, SI. Every 1/@rate@ s, tell @name@_act() where this drone and
 * the others are, how fast, and where they belong; it picks the @neighbours@ nearest itself.
@meaning@
 *
@costs@
 *
 * With @NAME@_SELF_TEST defined, @name@_self_test() gives the largest difference of an action
 * from the policy it was made from, over @samples@ states; it should be below 1e-5.
 */
#ifndef @NAME@_POLICY_H
#define @NAME@_POLICY_H

#include <math.h>

/* Types of vehicles. */
enum {
@types@
};
enum { @NAME@_NEIGHBOURS = @neighbours@, @NAME@_ACTIONS = @actions@ };

/* What is known of any drone. */
struct @name@_drone {
    float position[3]; /* m */
    float velocity[3]; /* m/s */
    float goal[3];     /* m: where it belongs@unused_goal@ */
    int type;          /* one of the enumeration@unused_type@ */@drone_load@
};

/* What a drone knows of itself beside that. */
struct @name@_own {
    float up[3];       /* direction of its thrust: third column of its rotation matrix */
    float thrust;      /* its thrust over the largest that it has */
    float setpoint[3]; /* position that its controller follows, m */
@own@
};

@tables@

struct @name@_layer {
    const float *weights; /* per output: its bias, then its row of the matrix */
    int inputs, outputs;
};

struct @name@_network {
    const struct @name@_layer *layers;
    int count;
};

@networks@

static inline float @name@_clamp(float value, float low, float high)
{
    return value < low ? low : (value > high ? high : value);
}

static inline float @name@_length(const float v[3])
{
    return sqrtf(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
}

/* Whether all three are finite. */
static inline int @name@_sound(const float v[3])
{
    return v[0] - v[0] == 0.0f && v[1] - v[1] == 0.0f && v[2] - v[2] == 0.0f;
}

/* Whether the policy was trained with vehicles of this type. */
static inline int @name@_known(int type) { @known@ }

/* Apply a network to values[0]; what is returned lies in one of the two rows. */
static inline float *@name@_apply(const struct @name@_network *net, int squash_last,
                                  float values[2][@widest@])
{
    int from = 0, k, o, i;
    for (k = 0; k < net->count; k++, from = 1 - from) {
        const struct @name@_layer *layer = &net->layers[k];
        const float *w = layer->weights, *x = values[from];
        for (o = 0; o < layer->outputs; o++) {
            float sum = *w++;
            for (i = 0; i < layer->inputs; i++) sum += w[i] * x[i];
            w += layer->inputs;
            values[1 - from][o] = squash_last || k < net->count - 1 ? @active@ : sum;
        }
    }
    return values[from];
}

/* Indices of the nearest others, nearest first; how many there are. */
static inline int @name@_nearest(const struct @name@_drone *self, int others,
                                 const struct @name@_drone *other, int found[@places@])
{
    float square[@places@];
    int count = 0, j, k;
    for (j = 0; j < others; j++) {
        float d = 0.0f;
        for (k = 0; k < 3; k++) {
            const float gap = other[j].position[k] - self->position[k];
            d += gap * gap;
        }
        k = count < @NAME@_NEIGHBOURS ? count++ : @NAME@_NEIGHBOURS;
        for (; k > 0 && square[k - 1] > d; k--) {
            if (k < @NAME@_NEIGHBOURS) square[k] = square[k - 1], found[k] = found[k - 1];
        }
        if (k < @NAME@_NEIGHBOURS) square[k] = d, found[k] = j;
    }
    return count;
}

