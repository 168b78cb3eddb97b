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

