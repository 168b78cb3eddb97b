/* Let an action steer the set-point; then advance it. */
static inline void @name@_steer(const float action[3], struct @name@_setpoint *s)
{
    const float length = @name@_length(action);
    const float scale = @speed@ / (length > 1.0f ? length : 1.0f);
    float asked[3], size;
    int k;
    for (k = 0; k < 3; k++)
        asked[k] = (scale * action[k] - s->velocity[k] - @tau@ * s->acceleration[k]) / @step@;
    size = @name@_length(asked) / @limit@;
    for (k = 0; k < 3 && size > 1.0f; k++) asked[k] /= size;
    @name@_accelerate(asked, s);
}

