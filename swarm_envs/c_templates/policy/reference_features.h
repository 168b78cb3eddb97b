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
                                             const struct @name@_own *own,
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
    (void)own;
}

