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
                                             const struct @name@_own *own,
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
    (void)own;
}

