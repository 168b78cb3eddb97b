/* Decide. Actions lie in [-1, 1]. Returns 1; or 0, with zeros, where an input is not finite
 * or a drone is of a type that the policy was not trained with. */
static inline int @name@_act(const struct @name@_drone *self, const struct @name@_own *own,
                             int others, const struct @name@_drone *other,
                             float action[@actions@])
{
    float values[2][@widest@];
    const float *result;
    int found[@places@] = {0}; /* or compilers warn, with room for one */
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
    result = @name@_apply(&@name@_actors[@who@], 0, values);
    for (k = 0; k < @actions@; k++) action[k] = @name@_clamp(result[k], -1.0f, 1.0f);
    return 1;
}

