/* The drone's own features and the neighbours' codes, weighed by attention, into values[0]. */
static inline void @name@_features(const struct @name@_drone *self, const struct @name@_own *own,
                                   int count, const int *found,
                                   const struct @name@_drone *other, float values[2][@widest@])
{
    float inner[2][@widest@], codes[@places@][@code@], mean[@code@], scores[@places@];
    float largest = 0.0f, total = 0.0f;
    int j, k;
    for (k = 0; k < @code@; k++) mean[k] = 0.0f;
    @name@_own_features(self, own, values[0]);
    for (j = 0; j < count; j++) {
        const float *member;
        for (k = 0; k < @own_width@; k++) inner[0][k] = values[0][k];
        @name@_neighbour_features(self, own, &other[found[j]], inner[0] + @own_width@);
        member = @name@_apply(&@name@_phis[@who@], 1, inner);
        for (k = 0; k < @code@; k++) codes[j][k] = member[k], mean[k] += member[k] / (float)count;
    }
    for (j = 0; j < count; j++) {
        for (k = 0; k < @code@; k++) inner[0][k] = codes[j][k], inner[0][@code@ + k] = mean[k];
        scores[j] = @name@_apply(&@name@_scores[@who@], 0, inner)[0];
        if (j == 0 || scores[j] > largest) largest = scores[j];
    }
    for (j = 0; j < count; j++) total += scores[j] = expf(scores[j] - largest);
    for (k = 0; k < @code@; k++) {
        float sum = 0.0f;
        for (j = 0; j < count; j++) sum += scores[j] * codes[j][k];
        values[0][@own_width@ + k] = count > 0 ? sum / total : 0.0f;
    }
}

