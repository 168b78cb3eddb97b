"""The C99 text of an exported policy, with @words@ where `c_header` puts numbers and names."""

HEAD = """\
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
    int type;          /* one of the enumeration@unused_type@ */
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
            values[1 - from][o] = squash_last || k < net->count - 1 ? tanhf(sum) : sum;
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

"""
"""What every policy has."""

GOAL_OWN = "    float time_left;   /* share of the clock that is left, from 1 to 0 */"
"""What a drone is told of itself where places are to be reached."""

GOAL = """\
/* What the network is told of the drone itself: @own_width@ numbers. */
static inline void @name@_own_features(const struct @name@_drone *self,
                                       const struct @name@_own *own, float *x)
{
    float goal[3], distance;
    int k;
    for (k = 0; k < 3; k++) goal[k] = self->goal[k] - self->position[k];
    distance = @name@_length(goal);
    for (k = 0; k < 3; k++) {
        x[k] = goal[k] / (distance > @goal_reach@ ? distance : @goal_reach@);
        x[4 + k] = self->velocity[k] / @speed@;
        x[7 + k] = own->up[k];
        x[11 + k] = own->setpoint[k] - self->position[k];
        x[14 + k] = self->position[k] / 2.0f;
    }
    x[3] = distance;
    x[10] = own->thrust;
    x[17] = own->time_left;@own_types@
}

/* What it is told of one neighbour: @neighbour_width@ numbers. */
static inline void @name@_neighbour_features(const struct @name@_drone *self,
                                             const struct @name@_drone *other, float *x)
{
    float p[3], v[3], goal[3], closest[3];
    float distance, approach = 0.0f, motion = 0.0f, time, reach;
    int k;
    for (k = 0; k < 3; k++) {
        p[k] = other->position[k] - self->position[k];
        v[k] = other->velocity[k] - self->velocity[k];
        goal[k] = other->goal[k] - other->position[k];
        approach -= p[k] * v[k];
        motion += v[k] * v[k];
    }
    distance = @name@_length(p);
    time = @name@_clamp(approach / (motion > 1e-6f ? motion : 1e-6f), 0.0f, @ahead@);
    reach = @name@_length(goal);
    if (reach < @goal_seen@) reach = @goal_seen@;
    for (k = 0; k < 3; k++) {
        closest[k] = p[k] + time * v[k];
        x[k] = p[k];
        x[4 + k] = v[k] / @speed@;
        x[8 + k] = closest[k];
        x[12 + k] = goal[k] / reach;
    }
    x[3] = expf(-distance / @near@);
    x[7] = time / @ahead@;
    x[11] = expf(-@name@_length(closest) / @near@);
    x[15] = approach / (distance > 1e-6f ? distance : 1e-6f) / @speed@;
    x[16] = 1.0f;@neighbour_types@
}

"""
"""Features of `swarm_envs.agents.features`."""

REFERENCE_OWN = """\
    float reference_position[3];     /* where it should be now, m */
    float reference_velocity[3];     /* m/s */
    float reference_acceleration[3]; /* m/s^2 */"""
"""What a drone is told of itself where a reference is to be kept to."""

REFERENCE = """\
/* What the network is told of the drone itself: @own_width@ numbers. */
static inline void @name@_own_features(const struct @name@_drone *self,
                                       const struct @name@_own *own, float *x)
{
    float error[3], distance;
    int k;
    for (k = 0; k < 3; k++) error[k] = own->reference_position[k] - self->position[k];
    distance = @name@_length(error);
    for (k = 0; k < 3; k++) {
        x[k] = error[k] / (distance > @reach@ ? distance : @reach@);
        x[4 + k] = (own->reference_velocity[k] - self->velocity[k]) / @fast@;
        x[7 + k] = own->reference_velocity[k];
        x[10 + k] = own->reference_acceleration[k];
        x[13 + k] = own->up[k];
        x[17 + k] = (own->setpoint[k] - self->position[k] - error[k]) / @reach@;
    }
    x[3] = distance;
    x[16] = own->thrust;@own_types@
}

/* What it is told of one neighbour: @neighbour_width@ numbers. */
static inline void @name@_neighbour_features(const struct @name@_drone *self,
                                             const struct @name@_drone *other, float *x)
{
    int k;
    for (k = 0; k < 3; k++) {
        x[k] = other->position[k] - self->position[k];
        x[3 + k] = (other->velocity[k] - self->velocity[k]) / @speed@;
    }
    x[6] = expf(-sqrtf(x[0] * x[0] + x[1] * x[1]) / @beside@);
    x[7] = x[6] * @name@_clamp(x[2] / @above@, -1.0f, 1.0f);
    x[11] = 1.0f;@neighbour_types@
}

"""
"""Features of `swarm_envs.agents.reference_features`."""

ONE_HOT = """
    for (k = 0; k < @NAME@_TYPES; k++) x[{start} + k] = {whose}->type == k ? 1.0f : 0.0f;"""
"""Types among the features."""

MLP = """\
/* Features into values[0]. */
static inline void @name@_features(const struct @name@_drone *self, const struct @name@_own *own,
                                   int count, const int *found,
                                   const struct @name@_drone *other, float values[2][@widest@])
{
    int j, k;
    @name@_own_features(self, own, values[0]);
    for (j = 0; j < @NAME@_NEIGHBOURS; j++) {
        float *x = values[0] + @own_width@ + j * @neighbour_width@;
        if (j < count)
            @name@_neighbour_features(self, &other[found[j]], x);
        else
            for (k = 0; k < @neighbour_width@; k++) x[k] = 0.0f;
    }
}

"""
"""Neighbours one after another."""

DEEP_SET = """\
/* The drone's own features and the @pooling@ of the neighbours' codes into values[0]. */
static inline void @name@_features(const struct @name@_drone *self, const struct @name@_own *own,
                                   int count, const int *found,
                                   const struct @name@_drone *other, float values[2][@widest@])
{
    float inner[2][@widest@], code[@code@];
    int j, k;
    for (k = 0; k < @code@; k++) code[k] = @first@;
    for (j = 0; j < count; j++) {
        const struct @name@_drone *o = &other[found[j]];
        const struct @name@_network *net = @phi_of@;
        const float *member;
        @name@_neighbour_features(self, o, inner[0]);
        member = @name@_apply(net, 1, inner);
        for (k = 0; k < @code@; k++) @pool@
    }
    @name@_own_features(self, own, values[0]);
    for (k = 0; k < @code@; k++) values[0][@own_width@ + k] = @result@;
}

"""
"""Neighbours as a set."""

ACT = """\
/* Decide. Actions lie in [-1, 1]. Returns 1; or 0, with zeros, where an input is not finite
 * or a drone is of a type that the policy was not trained with. */
static inline int @name@_act(const struct @name@_drone *self, const struct @name@_own *own,
                             int others, const struct @name@_drone *other,
                             float action[@actions@])
{
    float values[2][@widest@];
    const float *result;
    int found[@places@];
    int count, j, k;
    int sound = @name@_sound(self->position) && @name@_sound(self->velocity) &&
                @name@_sound(own->up) && own->thrust - own->thrust == 0.0f &&
                @name@_sound(own->setpoint) && @own_sound@;
    sound = sound && @name@_known(self->type);
    for (j = 0; j < others; j++)
        sound = sound && @name@_sound(other[j].position) && @name@_sound(other[j].velocity) &&
                @other_sound@;
    for (k = 0; k < @actions@; k++) action[k] = 0.0f;
    if (!sound) return 0;
    count = @name@_nearest(self, others, other, found);
    @name@_features(self, own, count, found, other, values);
    result = @name@_apply(@actor_of@, 0, values);
    for (k = 0; k < @actions@; k++) action[k] = @name@_clamp(result[k], -1.0f, 1.0f);
    return 1;
}

"""
"""From what is known to actions."""
