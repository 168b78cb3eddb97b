static const struct @name@_network @name@_phi[@NAME@_TYPES] = {
    @phi@};
static const struct @name@_network @name@_phi_environment = @environment@;
static const struct @name@_network @name@_rho[@NAME@_TYPES] = {
    @rho@};

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

/* Add the codes of the neighbors in the volume; whether there are any. */
static inline int @name@_neighbors(int neighbors, const int *types, const float *relative,
                                    float code[@hidden@])
{
    float values[2][@widest@];
    int any = 0, j, k;
    for (j = 0; j < neighbors; j++, relative += 6) {
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
                                   int neighbors, const int *types, const float *relative)
{
    const float anchor = @anchor@; /* m; a lone drone feels nothing from there up; 0 if unused */
    float code[@hidden@] = {0.0f}, alone[@hidden@] = {0.0f};
    float force = -@name@_drag[own_type][2] * velocity[2];
    const int low = anchor <= 0.0f || position[2] < anchor;
    if (!@name@_neighbors(neighbors, types, relative, code) && !low) return force;
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
                                int neighbors, const int *types, const float *relative,
                                float force[3])
{
    force[0] = -@name@_drag[own_type][0] * velocity[0];
    force[1] = -@name@_drag[own_type][1] * velocity[1];
    force[2] = @name@_force_z(own_type, position, velocity, neighbors, types, relative);
}

