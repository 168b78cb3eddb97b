"""More C99 text of an exported policy: what its actions do to set-points, and its own test."""

SETPOINT = """\
/* What the drone's controller follows. Begin with the drone's position, all else zero. */
struct @name@_setpoint {
    float position[3], velocity[3], acceleration[3], jerk[3]; /* m, m/s, m/s^2, m/s^3 */
};

/* Move a set-point on by dt seconds, at most to the next decision. */
static inline void @name@_advance(struct @name@_setpoint *s, float dt)
{
    int k;
    for (k = 0; k < 3; k++) {
        const float v = s->velocity[k], a = s->acceleration[k], j = s->jerk[k];
        s->position[k] += dt * (v + dt * (a / 2.0f + dt * j / 6.0f));
        s->velocity[k] += dt * (a + dt * j / 2.0f);
        s->acceleration[k] += dt * j;
    }
}

/* Set the jerk for the next 1/@rate@ s: the acceleration approaches asked[] (m/s^2) with a lag of
 * @tau@ s, at most to @speed@ m/s. */
static inline void @name@_accelerate(const float asked[3], struct @name@_setpoint *s)
{
    const float tau = @tau@, step = @step@;
    float coast[3], size, scale;
    int k;
    for (k = 0; k < 3; k++)
        coast[k] = s->velocity[k] + tau * s->acceleration[k] + asked[k] * step;
    size = @name@_length(coast);
    scale = size > @speed@ ? @speed@ / size : 1.0f;
    for (k = 0; k < 3; k++) {
        const float now = s->acceleration[k];
        const float gained = scale * coast[k] - s->velocity[k] - 0.5f * step * now;
        s->jerk[k] = (gained / (tau + 0.5f * step) - now) / step;
    }
}

"""
"""Of actions that steer a set-point."""

STEER_ACCELERATION = """\
/* Let an action steer the set-point; then advance it. */
static inline void @name@_steer(const float action[3], struct @name@_setpoint *s)
{
    float asked[3];
    int k;
    for (k = 0; k < 3; k++) asked[k] = @limit@ * action[k];
    @name@_accelerate(asked, s);
}

"""
"""Action `acceleration`."""

STEER_VELOCITY = """\
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

"""
"""Action `velocity`."""

TEST = """\
#ifdef @NAME@_SELF_TEST
/* Largest difference of an action from the policy that this was made from. */
static inline float @name@_self_test(void)
{
    /* number of others, own type, the others' */
    static const int kinds[@samples@][@kinds@] = {
@test_kinds@};
    /* own and others' position, velocity, goal; then the rest of what a drone knows of itself */
    static const float states[@samples@][@numbers@] = {
@test_states@};
    static const float actions[@samples@][@actions@] = {
@test_actions@};
    float worst = 0.0f;
    int n, j, k;
    for (n = 0; n < @samples@; n++) {
        struct @name@_drone drones[@drones@];
        struct @name@_own own;
        float action[@actions@];
        const float *s = states[n];
        for (j = 0; j < @drones@; j++) {
            for (k = 0; k < 3; k++) drones[j].position[k] = *s++;
            for (k = 0; k < 3; k++) drones[j].velocity[k] = *s++;
            for (k = 0; k < 3; k++) drones[j].goal[k] = *s++;
            drones[j].type = kinds[n][1 + j];
        }
        for (k = 0; k < 3; k++) own.up[k] = *s++;
        own.thrust = *s++;
        for (k = 0; k < 3; k++) own.setpoint[k] = *s++;
@test_own@
        if (!@name@_act(drones, &own, kinds[n][0], drones + 1, action)) return 1.0f;
        for (k = 0; k < @actions@; k++) {
            const float error = fabsf(action[k] - actions[n][k]);
            if (error > worst) worst = error;
        }
    }
    return worst;
}
#endif

#endif
"""
"""What the header's user can compare the target's arithmetic with."""
