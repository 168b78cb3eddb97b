/* The drone's own features and the @pooling@ of the neighbours' codes into values[0]. */
static inline void @name@_features(const struct @name@_drone *self, const struct @name@_own *own,
                                   int count, const int *found,
                                   const struct @name@_drone *other, float values[2][@widest@])
{
    float inner[2][@widest@], sum[@code@], largest[@code@];
    int j, k;
    for (k = 0; k < @code@; k++) sum[k] = 0.0f, largest[k] = -1.0f;
    @name@_own_features(self, own, values[0]);
    for (j = 0; j < count; j++) {
        const float *member;
        for (k = 0; k < @own_width@; k++) inner[0][k] = values[0][k];
        @name@_neighbour_features(self, own, &other[found[j]], inner[0] + @own_width@);
        member = @name@_apply(&@name@_phis[@who@], 1, inner);
        for (k = 0; k < @code@; k++) {
            sum[k] += member[k];
            if (member[k] > largest[k]) largest[k] = member[k];
        }
    }
    for (k = 0; k < @code@; k++) {
        @pooled@
    }
    (void)sum[0], (void)largest[0];
}

